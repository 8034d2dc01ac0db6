"""The kit: everything needed to build one design as a robot. Paper, "Manufacturing".

Needs the optional CAD packages; see :mod:`tasks.fabrication.cad`.
"""

from dataclasses import dataclass

from shapely import unary_union

from tasks.design import Designs
from tasks.design.genes import check
from tasks.fabrication.bill import BillLine, bill_of
from tasks.fabrication.built_bodies import Mechanism, mechanism_of
from tasks.fabrication.checks import KitFinding, findings_of
from tasks.fabrication.features import Feature, check_room_between, features_of
from tasks.fabrication.gauges import Gauge, gauges_of
from tasks.fabrication.kit_settings import KitSettings
from tasks.fabrication.parts import SIDES, BoughtPart, Part, bought_of, parts_of
from tasks.fabrication.profile import Profile, profile_of
from tasks.fabrication.rods import Layers, keep_out, layers_of, rod_circles
from tasks.fabrication.servo_joints import ServoJoint, servo_joints_of, servo_of
from tasks.fabrication.servos import Sense, Servo
from tasks.fabrication.splits import Split, split_of


@dataclass(frozen=True, eq=False)
class Kit:
    """A robot to build."""

    settings: KitSettings
    mechanism: Mechanism
    servo_joints: tuple[ServoJoint, ...]  # one per turning joint, in order of the child links
    profiles: tuple[Profile, ...]  # one per body
    layers: Layers
    splits: tuple[Split, ...]
    features: dict[tuple[int, str], tuple[Feature, ...]]
    """Features cut out of each copy of a body, by the body's index and the side."""
    parts: tuple[Part, ...]  # pieces to print
    bought: tuple[BoughtPart, ...]  # servos, horns, rods and pins, in place
    gauges: tuple[Gauge, ...]  # test prints for the fit of servo and horn
    findings: tuple[KitFinding, ...]  # faults first
    bill: tuple[BillLine, ...]

    @property
    def servo(self) -> Servo:
        """The servo of every joint, with its one horn and the user's measurements."""
        return servo_of(self.settings)

    @property
    def mass_g(self) -> float:
        """Mass of prints, servos and steel, without screws and cables."""
        return sum(line.mass_g for line in self.bill if line.mass_g is not None)

    @property
    def hull_mm3(self) -> float:
        """Volume inside the outlines of both pontoons, including hollows."""
        area: float = sum(profile.face.area for profile in self.profiles)
        return 2 * self.settings.thickness_mm * area

    @property
    def printed_mm3(self) -> float:
        """Volume of the prints, which displaces water once all hollows are flooded."""
        return sum(part.volume_mm3 for part in self.parts)

    def direction(self, joint: int, side: str) -> Sense:
        """Return 1 if longer pulses turn a joint's child link counter-clockwise, seen with x to the right; else -1.

        The joint is given by the number of its child link, the servo by its pontoon, left or right.
        """
        servo_joint = next(servo_joint for servo_joint in self.servo_joints if servo_joint.joint.link == joint)
        return servo_joint.direction(carrier_is_outer=self.layers.outer[servo_joint.carrier], side=side)


def build_kit(design: Designs, settings: KitSettings) -> Kit:
    """Make the parts of one design and check them. Joints whose motor is off are locked at rest.

    Raises:
        DesignError: The design is invalid.
        ServoError: The library has no such servo or horn, or the measurements contradict each other.
        KitError: No part can be made with these settings.
        SolidError: The CAD kernel made a solid that does not match the outlines.
    """
    check(design)
    mechanism = mechanism_of(design, settings)
    servo_joints = servo_joints_of(mechanism, settings)
    check_room_between(servo_joints, settings)
    profiles = tuple(profile_of(mechanism, servo_joints, body.index, settings) for body in mechanism.bodies)
    outlines = [profile.polygon for profile in profiles]
    layers = layers_of(mechanism, servo_joints, outlines, settings)
    splits, features, parts = [], {}, []
    for body in mechanism.bodies:
        bores = rod_circles(layers.rods[body.index], (settings.rod_mm + settings.rod_clearance_mm) / 2)
        taken = unary_union([keep_out(servo_joints, body.index), bores])
        split = split_of(mechanism, body.index, outlines[body.index], taken, settings)
        splits.append(split)
        for side in SIDES:
            cut = features_of(body.index, side, servo_joints, layers.rods[body.index], settings)
            features[body.index, side] = cut
            name = f"part-{body.index + 1}-{side}"
            parts += parts_of(name, body.index, side, profiles[body.index], cut, split, layers, settings)
    return Kit(
        settings=settings,
        mechanism=mechanism,
        servo_joints=servo_joints,
        profiles=profiles,
        layers=layers,
        splits=tuple(splits),
        features=features,
        parts=tuple(parts),
        bought=tuple(bought_of(servo_joints, layers, settings)),
        gauges=gauges_of(servo_joints, settings),
        findings=findings_of(mechanism, servo_joints, outlines, layers, splits, features, settings),
        bill=tuple(bill_of(parts, servo_joints, layers, settings)),
    )
