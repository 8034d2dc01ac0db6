"""Drives: where the servo of every joint sits, and what is printed around it. The paper's were drawn by hand.

How a joint is assembled, decided here:

- Two parts that turn on one another can't lie in one plane, so each pontoon has two layers of parts with a gap
  between. Joined parts lie in different layers, by their depth in the tree; so parts in the same layer are never
  joined. Parts that are joined pass one another whole on the bench, while those of their links that no joint joins may
  collide in the simulation: there the bench's robot is freer than the simulated one.
- The servo's shaft lies along the extrusion, through the joint. Its case goes into a pocket of one part from the back,
  away from the other layer, until its top is flush with the part's face; the ears bear on the plate that the pocket
  leaves there and are screwed to it from behind. What is longer than the part stands out behind, where nothing moves.
- The horn lies in a recess in the face of the other part and is held by screws that go through that part; a hole over
  the shaft lets the centre screw in from that part's back when the two lie face to face.
- With one servo at a joint, as in the paper (two servos in all), the servos of successive joints sit in the left and in
  the right pontoon by turns, for balance. The other pontoon turns on a pin of the rods' steel. Both have one outline.
- Either of the joint's two parts may carry the servo, along or across its link: whichever makes the least stand out.
  A link may be 23 mm wide and a cradle 27: then the cradle stands out of the link as a boss, and that is reported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import cos, pi, sin

from shapely import Point as ShapelyPoint
from shapely import affinity, box, unary_union
from shapely.geometry.base import BaseGeometry

from tasks.fabrication.built_bodies import Joint, Mechanism, Point, swept
from tasks.fabrication.kit_settings import KitSettings
from tasks.fabrication.servos import Horn, Sense, Servo, as_measured, servo_named

HIT_COST = 10.0
"""Of a square millimetre of a boss in the way of another part, against one that merely stands out of its own."""
CONFLICT_COST = 1000.0
"""Of a square millimetre that two servos would share."""


COST_DIGITS = 3
"""Candidates whose costs agree so far are equally good, and the first is taken, whatever the rounding."""
CABLE_ROOM_MM = 1.0
"""Added to a cable's width."""


@dataclass(frozen=True, eq=False)
class ServoJoint:
    """A joint's servo in one part and its horn in the other."""

    joint: Joint
    number: int
    """Of the drives, from 0."""
    servo: Servo
    horn: Horn
    carrier: int
    """Index of the body that holds the servo."""
    carrier_link: int
    driven: int
    """Index of the body that the horn turns."""
    angle: float
    """Of the servo's long side in the plane, from the shaft to the far end [rad]."""
    clearance_mm: float
    wall_mm: float

    @property
    def pocket(self) -> BaseGeometry:
        """What the ears need, with clearance."""
        over = (self.servo.ear_length_mm - self.servo.length_mm) / 2
        return self.placed(
            -self.servo.shaft_offset_mm - over - self.clearance_mm,
            self.servo.length_mm - self.servo.shaft_offset_mm + over + self.clearance_mm,
            self.servo.width_mm / 2 + self.clearance_mm,
        )

    @property
    def case(self) -> BaseGeometry:
        """What the case needs, with clearance."""
        return self.placed(
            -self.servo.shaft_offset_mm - self.clearance_mm,
            self.servo.length_mm - self.servo.shaft_offset_mm + self.clearance_mm,
            self.servo.width_mm / 2 + self.clearance_mm,
        )

    @property
    def cable_ways(self) -> list[BaseGeometry]:
        """The notches in the pocket's walls at both of the servo's ends."""
        over = (self.servo.ear_length_mm - self.servo.length_mm) / 2 + self.clearance_mm
        near = -self.servo.shaft_offset_mm - over
        far = self.servo.length_mm - self.servo.shaft_offset_mm + over
        half = (self.servo.cable_width_mm + CABLE_ROOM_MM) / 2
        return [self.placed(near - self.wall_mm, near, half), self.placed(far, far + self.wall_mm, half)]

    @property
    def cradle(self) -> BaseGeometry:
        """The pocket and its walls."""
        return self.pocket.buffer(self.wall_mm)

    @property
    def cradle_width_mm(self) -> float:
        """Across the servo."""
        return self.servo.width_mm + 2 * (self.clearance_mm + self.wall_mm)

    @property
    def recess_radius_mm(self) -> float:
        """Within which the horn lies, with clearance."""
        return max(self.horn.long_mm, self.horn.short_mm) + self.clearance_mm

    @property
    def recess(self) -> BaseGeometry:
        """The circle within which the horn lies."""
        return ShapelyPoint(self.joint.at).buffer(self.recess_radius_mm, quad_segs=32)

    @property
    def seat(self) -> BaseGeometry:
        """The recess and its wall."""
        return ShapelyPoint(self.joint.at).buffer(self.recess_radius_mm + self.wall_mm, quad_segs=32)

    def placed(self, u_from: float, u_to: float, half_v: float) -> BaseGeometry:
        """Put a rectangle of the servo's frame into the plane."""
        lying = affinity.rotate(box(u_from, -half_v, u_to, half_v), self.angle, origin=(0, 0), use_radians=True)
        return affinity.translate(lying, *self.joint.at)

    def point(self, u: float, v: float) -> Point:
        """Put a point of the servo's frame into the plane."""
        c, s = cos(self.angle), sin(self.angle)
        return (self.joint.at[0] + c * u - s * v, self.joint.at[1] + s * u + c * v)

    def ear_holes(self) -> list[Point]:
        """Give the screws' places in the plane."""
        middle = self.servo.length_mm / 2 - self.servo.shaft_offset_mm
        aside = self.servo.hole_pitch_mm / 2
        across = [-aside, aside] if aside else [0.0]
        return [self.point(middle + end * self.servo.hole_span_mm / 2, v) for end in (-1, 1) for v in across]

    def horn_holes(self) -> list[Point]:
        """Give the places of the screws into the horn; on a cross's arms."""
        r = self.horn.screw_radius_mm
        return [self.point(r * cos(turn * pi / 2), r * sin(turn * pi / 2)) for turn in range(4)]

    def sides(self, servos_per_joint: int) -> tuple[str, ...]:
        """Name the pontoons that hold a servo at this joint."""
        return ("left", "right") if servos_per_joint == 2 else (("left", "right")[self.number % 2],)

    def direction(self, *, carrier_is_outer: bool, side: str) -> Sense:
        """Give 1 if longer pulses turn the child link counter-clockwise, seen with x to the right.

        The shaft points from the carrier to the other layer: towards +z in an outer part of the left pontoon.
        """
        upward = carrier_is_outer == (side == "left")
        signs = self.servo.sense * (1 if upward else -1) * (1 if self.carrier == self.joint.parent else -1)
        return 1 if signs > 0 else -1


def servo_of(settings: KitSettings) -> Servo:
    """Give the servo that a kit is made for, with its one horn.

    Raises:
        ServoError: the library has no such servo, or it no such horn, or its measures contradict one another.
    """
    return as_measured(servo_named(settings.servo), settings.horn, settings.measured)


def servo_joints_of(mechanism: Mechanism, settings: KitSettings) -> tuple[ServoJoint, ...]:
    """Choose for every joint, one after the other, which part carries its servo and how it lies.

    Raises:
        ServoError: as :func:`servo_of`.
    """
    servo = servo_of(settings)
    (horn,) = servo.horns
    ways = {body.index: _ways(mechanism, body.index) for body in mechanism.bodies} if mechanism.joints else {}
    servo_joints: list[ServoJoint] = []
    for number, joint in enumerate(mechanism.joints):
        candidates = [
            ServoJoint(
                joint=joint,
                number=number,
                servo=servo,
                horn=horn,
                carrier=carrier,
                carrier_link=link,
                driven=joint.child if carrier == joint.parent else joint.parent,
                angle=mechanism.link_angle[link] + pi / 2 + quarter * pi / 2,
                clearance_mm=settings.servo_clearance_mm,
                wall_mm=settings.wall_mm,
            )
            for carrier, link in ((joint.parent, joint.parent_link), (joint.child, joint.link))
            for quarter in range(4)
        ]
        costs = [round(_cost(candidate, mechanism, servo_joints, ways), COST_DIGITS) for candidate in candidates]
        servo_joints.append(candidates[costs.index(min(costs))])
    return tuple(servo_joints)


def _ways(mechanism: Mechanism, body: int) -> BaseGeometry:
    """Give where other parts of the same layer may come, seen from a part."""
    own = mechanism.bodies[body]
    others = [other for other in mechanism.bodies if other.index != body and (other.depth - own.depth) % 2 == 0]
    return unary_union([swept(o.outline, mechanism.poses_in_range(body, o.index)[::2]) for o in others])


def _cost(
    servo_joint: ServoJoint, mechanism: Mechanism, placed: Sequence[ServoJoint], ways: Mapping[int, BaseGeometry]
) -> float:
    """Say how much of a drive stands out of its parts, is in another part's way, or in another drive's [mm²]."""
    cost = 0.0
    for body, boss in ((servo_joint.carrier, servo_joint.cradle), (servo_joint.driven, servo_joint.seat)):
        outside = boss.difference(mechanism.bodies[body].outline)
        cost += outside.area + HIT_COST * outside.intersection(ways[body]).area
        taken = [d.cradle if d.carrier == body else d.seat for d in placed if body in (d.carrier, d.driven)]
        to_come = [
            least_seat(servo_joint, joint.at)
            for joint in mechanism.joints[servo_joint.number + 1 :]
            if body in (joint.parent, joint.child)
        ]
        cost += CONFLICT_COST * boss.intersection(unary_union([*taken, *to_come])).area
    return cost


def least_seat(servo_joint: ServoJoint, at: Point) -> BaseGeometry:
    """Give the room that a drive like this one needs at least at another joint."""
    return ShapelyPoint(at).buffer(servo_joint.recess_radius_mm + servo_joint.wall_mm)


def outline_with_bosses(mechanism: Mechanism, servo_joints: Sequence[ServoJoint], body: int) -> BaseGeometry:
    """Unite a part's links and the bosses of its drives."""
    bosses = [d.cradle for d in servo_joints if d.carrier == body] + [d.seat for d in servo_joints if d.driven == body]
    return unary_union([mechanism.bodies[body].outline, *bosses])
