"""A design as a model of MuJoCo, to try it in another simulator.

The plane of motion is MuJoCo's x and z; angles turn from x to z, as here. A link is 1 m wide in y, so that a density
in kg/m² stays what it is. MuJoCo has no slush: the model is that of Dry Land. A motor pushes with at most its torque
towards the speed gain · (θ* - θ), softly instead of within a step; contacts are soft, too.
"""

from xml.etree import ElementTree as Xml

import numpy as np

from tasks.design.body import kinematic_trees
from tasks.design.genes import N_LINKS, Designs
from tasks.world.physics import Physics

LONGEST_STEP = 1 / 240  # [s]; contacts in MuJoCo want shorter steps than Box2D's
_SOFTNESS = 1.0  # error of a motor's speed at which its torque is the largest [rad/s]


def mjcf(design: Designs, depth: float, physics: Physics | None = None) -> str:
    """Return the XML of a single design over ground at y = -depth [m], spawned as in a rollout.

    The target angle of the actuator ``motor-i`` at time t is rest + amplitude · sin(2π f t + phase) [rad]; the model's
    numeric ``gait-i`` has rest, amplitude, f and phase.
    """
    physics = physics or Physics()
    trees = kinematic_trees(design, density=physics.link_density)
    model = Xml.Element("mujoco", model="puddle")
    Xml.SubElement(model, "compiler", angle="radian")
    Xml.SubElement(
        model,
        "option",
        timestep=_number(min(physics.time_step, LONGEST_STEP)),
        gravity=_numbers(0, 0, -physics.gravity),
        integrator="implicitfast",
        cone="elliptic",
    )
    default = Xml.SubElement(Xml.SubElement(model, "default"), "geom", friction=_numbers(physics.friction, 0, 0))
    default.set("density", _number(physics.link_density))
    custom, world = Xml.SubElement(model, "custom"), Xml.SubElement(model, "worldbody")
    ground = {"type": "plane", "size": "0 0 1", "pos": _numbers(0, 0, -depth), "contype": "2", "conaffinity": "1"}
    Xml.SubElement(world, "geom", ground, name="ground")
    actuators = Xml.SubElement(model, "actuator")
    bodies: list[Xml.Element] = []
    for link in range(N_LINKS):
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
            name=f"link-{link}",
            pos=_numbers(*place),
            quat=_numbers(np.cos(turned / 2), 0, -np.sin(turned / 2), 0),
        )
        bodies.append(body)
        if link == 0:
            for name, axis in (("x", "1 0 0"), ("z", "0 0 1")):
                Xml.SubElement(body, "joint", name=f"root-{name}", type="slide", axis=axis)
            Xml.SubElement(body, "joint", name="root-angle", type="hinge", axis="0 -1 0")
        elif on or physics.passive_joints == "swing":
            hinge = {"type": "hinge", "axis": "0 -1 0", "pos": _numbers(0, 0, along_child), "ref": _number(rest)}
            Xml.SubElement(body, "joint", hinge, name=f"joint-{link}")
        half = trees.half_width[0, link], 0.5, trees.half_height[0, link]
        collides = {"contype": "1", "conaffinity": "3" if physics.link_collisions else "2"}
        Xml.SubElement(body, "geom", collides, name=f"box-{link}", type="box", size=_numbers(*half))
        if on:
            torque, slope = physics.max_motor_torque, physics.max_motor_torque / _SOFTNESS
            motor = {"kp": _number(physics.motor_gain * slope), "kv": _number(slope)}
            motor |= {"joint": f"joint-{link}", "forcelimited": "true", "forcerange": _numbers(-torque, torque)}
            Xml.SubElement(actuators, "position", motor, name=f"motor-{link}")
            gait = _numbers(rest, design.motion_range[0, link], design.frequency[0], design.phase[0, link])
            Xml.SubElement(custom, "numeric", name=f"gait-{link}", data=gait)
    Xml.indent(model)
    return Xml.tostring(model, encoding="unicode") + "\n"


def _number(value: float) -> str:
    return f"{float(value):.9g}"


def _numbers(*values: float) -> str:
    return " ".join(_number(value) for value in values)
