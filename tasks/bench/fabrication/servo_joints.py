"""Servo joints: where the servo of every joint sits, and what is printed around it. The paper's were drawn by hand.

A joint is assembled as follows:

- Parts that turn on each other can't lie in one plane, so each pontoon has two layers of parts with a gap between them.
  The layer of a part follows from its depth in the tree, so that parts joined by a joint pass each other.
- The servo's shaft lies along z, through the joint. Its case enters a pocket of one part from the back, away from the
  other layer, until its top is flush with the part's face. The ears rest on the plate that the pocket leaves there and
  are screwed to it from behind. What is longer than the part stands out behind, where nothing moves.
- The horn lies in a recess in the face of the other part, held by screws through that part. A hole over the shaft
  admits the centre screw from that part's back when the two lie face to face.
- With one servo per joint, as in the paper (two servos in all), the servos of successive joints alternate between the
  left and the right pontoon, for balance. The other pontoon turns on a pin. Both pontoons have the same outline.
- Either part of the joint may carry the servo, along or across its link, whichever makes the least stand out. Where a
  cradle is wider than its link, it stands out as a boss.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import cos, pi, sin

from shapely import Point as ShapelyPoint
from shapely import affinity, box, unary_union
from shapely.geometry.base import BaseGeometry

from tasks.bench.fabrication.built_bodies import Mechanism, Point, TurningJoint, swept
from tasks.bench.fabrication.kit_settings import KitSettings
from tasks.bench.fabrication.printing import WALL_MM
from tasks.bench.fabrication.servos import Horn, Sense, Servo

_HIT_COST = 10.0  # per mm² of a boss in the way of another part, where 1 mm² outside its own part costs 1
_CONFLICT_COST = 1000.0  # per mm² shared by two servos
_COST_DIGITS = 3  # candidates with equal rounded costs are equally good; the first is taken
_CABLE_CLEARANCE_MM = 1.0


@dataclass(frozen=True, eq=False)
class ServoJoint:
    """A turning joint with its servo in one part and its horn in the other."""

    joint: TurningJoint
    number: int  # index among the servo joints
    servo: Servo  # with its one horn
    carrier: int  # index of the body that holds the servo
    driven: int  # index of the body that the horn turns
    angle: float  # angle of the servo's long side in the plane, from the shaft to the far end [rad]
    settings: KitSettings

    @property
    def horn(self) -> Horn:
        """The servo's horn."""
        return self.servo.horns[0]

    @property
    def sides(self) -> tuple[str, ...]:
        """Pontoons that hold a servo at this joint."""
        return ("left", "right") if self.settings.servos_per_joint == 2 else (("left", "right")[self.number % 2],)

    def _ends(self, over: float) -> Point:
        """Return both ends, along the servo, of what reaches over the case by some length [mm], with clearance."""
        servo, clearance = self.servo, self.settings.servo_clearance_mm
        return -servo.shaft_offset_mm - over - clearance, servo.length_mm - servo.shaft_offset_mm + over + clearance

    @property
    def _ear_mm(self) -> float:
        return (self.servo.ear_length_mm - self.servo.length_mm) / 2

    @property
    def pocket(self) -> BaseGeometry:
        """Outline of the ears, with clearance."""
        return self.rectangle(self._ends(self._ear_mm), self.servo.width_mm / 2 + self.settings.servo_clearance_mm)

    @property
    def case(self) -> BaseGeometry:
        """Outline of the case, with clearance."""
        return self.rectangle(self._ends(0.0), self.servo.width_mm / 2 + self.settings.servo_clearance_mm)

    @property
    def cable_ways(self) -> list[BaseGeometry]:
        """Notches in the pocket's walls at both ends of the servo."""
        near, far = self._ends(self._ear_mm)
        half = (self.servo.cable_width_mm + _CABLE_CLEARANCE_MM) / 2
        return [self.rectangle((near - WALL_MM, near), half), self.rectangle((far, far + WALL_MM), half)]

    @property
    def cradle(self) -> BaseGeometry:
        """The pocket with its walls."""
        return self.pocket.buffer(WALL_MM)

    @property
    def cradle_width_mm(self) -> float:
        """Width of the cradle across the servo."""
        return self.servo.width_mm + 2 * (self.settings.servo_clearance_mm + WALL_MM)

    @property
    def recess_radius_mm(self) -> float:
        """Radius of the circle around the horn, with clearance."""
        return max(self.horn.long_mm, self.horn.short_mm) + self.settings.servo_clearance_mm

    @property
    def recess(self) -> BaseGeometry:
        """Circle around the horn, with clearance."""
        return ShapelyPoint(self.joint.at).buffer(self.recess_radius_mm, quad_segs=32)

    @property
    def seat_radius_mm(self) -> float:
        """Radius of the recess with its wall."""
        return self.recess_radius_mm + WALL_MM

    @property
    def seat(self) -> BaseGeometry:
        """The recess with its wall."""
        return ShapelyPoint(self.joint.at).buffer(self.seat_radius_mm, quad_segs=32)

    def rectangle(self, u: tuple[float, float], half_v: float) -> BaseGeometry:
        """Place a rectangle in the plane: its two ends along the servo and half its width across the servo [mm]."""
        lying = affinity.rotate(box(u[0], -half_v, u[1], half_v), self.angle, origin=(0, 0), use_radians=True)
        return affinity.translate(lying, *self.joint.at)

    def point(self, u: float, v: float) -> Point:
        """Place a point of the servo's frame in the plane."""
        c, s = cos(self.angle), sin(self.angle)
        return (self.joint.at[0] + c * u - s * v, self.joint.at[1] + s * u + c * v)

    def ear_holes(self) -> list[Point]:
        """Return the positions of the ear screws in the plane."""
        middle = self.servo.length_mm / 2 - self.servo.shaft_offset_mm
        aside = self.servo.hole_pitch_mm / 2
        across = [-aside, aside] if aside else [0.0]
        return [self.point(middle + end * self.servo.hole_span_mm / 2, v) for end in (-1, 1) for v in across]

    def horn_holes(self) -> list[Point]:
        """Return the positions of the horn's screws in the plane; those of a cross lie on its arms."""
        r = self.horn.screw_radius_mm
        return [self.point(r * cos(turn * pi / 2), r * sin(turn * pi / 2)) for turn in range(4)]

    def direction(self, *, carrier_is_outer: bool, side: str) -> Sense:
        """Return 1 if longer pulses turn the child link counter-clockwise, seen with x to the right; else -1.

        The shaft points from the carrier to the other layer: towards +z in an outer part of the left pontoon.
        """
        upward = carrier_is_outer == (side == "left")
        signs = self.servo.sense * (1 if upward else -1) * (1 if self.carrier == self.joint.parent else -1)
        return 1 if signs > 0 else -1


def servo_joints_of(mechanism: Mechanism, servo: Servo, settings: KitSettings) -> tuple[ServoJoint, ...]:
    """Choose, joint by joint, which part carries the servo and how it lies."""
    ways = {body.index: _ways(mechanism, body.index) for body in mechanism.bodies} if mechanism.joints else {}
    servo_joints: list[ServoJoint] = []
    for number, joint in enumerate(mechanism.joints):
        candidates = [
            ServoJoint(
                joint=joint,
                number=number,
                servo=servo,
                carrier=carrier,
                driven=joint.child if carrier == joint.parent else joint.parent,
                angle=mechanism.link_angle[link] + pi / 2 + quarter * pi / 2,
                settings=settings,
            )
            for carrier, link in ((joint.parent, joint.parent_link), (joint.child, joint.link))
            for quarter in range(4)
        ]
        costs = [round(_cost(candidate, mechanism, servo_joints, ways), _COST_DIGITS) for candidate in candidates]
        servo_joints.append(candidates[costs.index(min(costs))])
    return tuple(servo_joints)


def _ways(mechanism: Mechanism, body: int) -> BaseGeometry:
    """Return the area that other parts of the same layer sweep, relative to a part."""
    depth = mechanism.bodies[body].depth
    others = [other for other in mechanism.bodies if other.index != body and (other.depth - depth) % 2 == 0]
    return unary_union([swept(o.outline, mechanism.poses_in_range(body, o.index)[::2]) for o in others])


def _cost(
    servo_joint: ServoJoint, mechanism: Mechanism, placed: Sequence[ServoJoint], ways: Mapping[int, BaseGeometry]
) -> float:
    """Weigh the area [mm²] by which a servo joint leaves its parts, blocks another part or meets another servo."""
    cost = 0.0
    for body, boss in ((servo_joint.carrier, servo_joint.cradle), (servo_joint.driven, servo_joint.seat)):
        outside = boss.difference(mechanism.bodies[body].outline)
        cost += outside.area + _HIT_COST * outside.intersection(ways[body]).area
        taken = [d.cradle if d.carrier == body else d.seat for d in placed if body in (d.carrier, d.driven)]
        to_come = [  # the least area that a servo joint like this one needs at another joint
            ShapelyPoint(joint.at).buffer(servo_joint.seat_radius_mm)
            for joint in mechanism.joints[servo_joint.number + 1 :]
            if body in (joint.parent, joint.child)
        ]
        cost += _CONFLICT_COST * boss.intersection(unary_union([*taken, *to_come])).area
    return cost
