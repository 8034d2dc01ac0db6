"""Designs, and links that are thrown, as models of MuJoCo.

The plane of motion is MuJoCo's x and z; angles turn from x to z, as here. A link is 1 m wide in y, so that a density
in kg/m² stays what it is. A motor pushes with at most its torque towards the speed gain · (θ* - θ), softly instead of
within a step; contacts are soft, too. Media are no part of a model, but for MuJoCo's own fluid: the model has what it
needs of that, and tasks/simulation/mujoco.py says in each step how much of a link is under water.
"""

from xml.etree import ElementTree as Xml

import numpy as np

from tasks.arrays import Floats
from tasks.design.body import kinematic_trees
from tasks.design.controllers import OPEN_LOOP
from tasks.design.genes import Designs
from tasks.world.mujoco_fluid import MujocoFluid
from tasks.world.physics import Physics

LONGEST_STEP = 1 / 240  # [s]; contacts in MuJoCo want shorter steps than Box2D's
_BUOYANT = {"gravcomp": "1"}  # without a value in its model, MuJoCo ignores the one of a step
_SOFTNESS = 1.0  # error of a motor's speed at which its torque is the largest [rad/s]


def mjcf(design: Designs, depth: float, physics: Physics | None = None, fluid: MujocoFluid | None = None) -> str:
    """Return the XML of a single design over ground at y = -depth [m], spawned as in a rollout.

    The target angle of the actuator ``motor-i`` at time t is rest + amplitude · sin(2π f t + phase) [rad]; the model's
    numeric ``gait-i`` has rest, amplitude, f and phase. Of a robot with another controller than the paper's that is the
    oscillator alone, and the model's text ``controller`` names what it lacks.
    """
    physics = physics or Physics()
    trees = kinematic_trees(design, density=physics.link_density)
    model, world = _model(physics, fluid)
    custom = Xml.SubElement(model, "custom")
    if design.controller != OPEN_LOOP:
        Xml.SubElement(custom, "text", name="controller", data=design.controller)
    ground = {"type": "plane", "size": "0 0 1", "pos": _numbers(0, 0, -depth), "contype": "2", "conaffinity": "1"}
    Xml.SubElement(world, "geom", ground, name="ground")
    actuators = Xml.SubElement(model, "actuator")
    bodies: list[Xml.Element] = []
    for link in range(design.room):
        along_parent, along_child = float(trees.parent_anchor[0, link]), float(trees.child_anchor[0, link])
        rest, on = float(design.rest_angle[0, link]), link > 0 and bool(design.motor_on[0, link])
        if link == 0:
            above, place, turned = world, (0.0, 0.0, float(trees.y[0, 0])), 0.0
        else:
            above, turned = bodies[design.parent[0, link]], rest
            place = (np.sin(rest) * along_child, 0.0, along_parent - np.cos(rest) * along_child)
        body = Xml.SubElement(
            above,
            "body",
            _BUOYANT if fluid else {},
            name=f"link-{link}",
            pos=_numbers(*place),
            quat=_numbers(np.cos(turned / 2), 0, -np.sin(turned / 2), 0),
        )
        bodies.append(body)
        if link == 0:
            _free(body, "root")
        elif on or physics.passive_joints == "swing":
            hinge = {"type": "hinge", "axis": "0 -1 0", "pos": _numbers(0, 0, along_child), "ref": _number(rest)}
            Xml.SubElement(body, "joint", hinge, name=f"joint-{link}")
        half = float(trees.half_width[0, link]), float(trees.half_height[0, link])
        _box(body, link, *half, contype="1", conaffinity="3" if physics.link_collisions else "2")
        if on:
            torque, slope = physics.max_motor_torque, physics.max_motor_torque / _SOFTNESS
            motor = {"kp": _number(physics.motor_gain * slope), "kv": _number(slope)}
            motor |= {"joint": f"joint-{link}", "forcelimited": "true", "forcerange": _numbers(-torque, torque)}
            Xml.SubElement(actuators, "position", motor, name=f"motor-{link}")
            gait = _numbers(rest, design.motion_range[0, link], design.frequency[0], design.phase[0, link])
            Xml.SubElement(custom, "numeric", name=f"gait-{link}", data=gait)
    return _text(model)


def free_links_mjcf(length_scale: Floats, physics: Physics, fluid: MujocoFluid) -> str:
    """Return the XML of (n_links,) links of these long axes [m], which do not collide."""
    model, world = _model(physics, fluid)
    for link, length in enumerate(length_scale):
        body = Xml.SubElement(world, "body", _BUOYANT, name=f"link-{link}")
        _free(body, f"link-{link}")
        _box(body, link, 0.5 / length, length / 2, contype="0", conaffinity="0")
    return _text(model)


def _model(physics: Physics, fluid: MujocoFluid | None) -> tuple[Xml.Element, Xml.Element]:
    """Return a model without bodies, and its world."""
    model = Xml.Element("mujoco", model="puddle")
    Xml.SubElement(model, "compiler", angle="radian")
    step, gravity = _number(min(physics.time_step, LONGEST_STEP)), _numbers(0, 0, -physics.gravity)
    option = {"timestep": step, "gravity": gravity, "integrator": "implicitfast", "cone": "elliptic"}
    geom = {"friction": _numbers(physics.friction, 0, 0), "density": _number(physics.link_density)}
    if fluid is not None:
        option["density"] = _number(fluid.density)
        geom |= {"fluidshape": "ellipsoid", "fluidcoef": _numbers(*fluid.coefficients)}
    Xml.SubElement(model, "option", option)
    Xml.SubElement(Xml.SubElement(model, "default"), "geom", geom)
    return model, Xml.SubElement(model, "worldbody")


def _free(body: Xml.Element, name: str) -> None:
    """Let a body move and turn in the plane."""
    for direction, axis in (("x", "1 0 0"), ("z", "0 0 1")):
        Xml.SubElement(body, "joint", name=f"{name}-{direction}", type="slide", axis=axis)
    Xml.SubElement(body, "joint", name=f"{name}-angle", type="hinge", axis="0 -1 0")


def _box(body: Xml.Element, link: int, half_width: float, half_height: float, **collides: str) -> None:
    """Add the box of a link."""
    size = _numbers(half_width, 0.5, half_height)
    Xml.SubElement(body, "geom", collides, name=f"box-{link}", type="box", size=size)


def _text(model: Xml.Element) -> str:
    Xml.indent(model)
    return Xml.tostring(model, encoding="unicode") + "\n"


def _number(value: float) -> str:
    return f"{float(value):.9g}"


def _numbers(*values: float) -> str:
    return " ".join(_number(value) for value in values)
