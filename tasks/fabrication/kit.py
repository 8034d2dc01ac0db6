"""A kit: everything that is known of the robot to be built from one design. Paper, "Manufacturing".

Needs the optional packages of CAD; see :mod:`tasks.fabrication.cad`.
"""

from __future__ import annotations

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
from tasks.fabrication.servo_joints import ServoJoint, servo_joints_of
from tasks.fabrication.servos import Sense
from tasks.fabrication.splits import Split, split_of


@dataclass(frozen=True, eq=False)
class Kit:
    """A robot to be built."""

    settings: KitSettings
    mechanism: Mechanism
    """Rigid bodies and turning joints."""
    servo_joints: tuple[ServoJoint, ...]
    """One for every turning joint, in order of their child links."""
    profiles: tuple[Profile, ...]
    """Of every body."""
    layers: Layers
    splits: tuple[Split, ...]
    features: dict[tuple[int, str], tuple[Feature, ...]]
    """What is cut out of every body's copy, by its index and side."""
    parts: tuple[Part, ...]
    """Pieces to print."""
    bought: tuple[BoughtPart, ...]
    """Servos, horns, rods and pins, in their places."""
    gauges: tuple[Gauge, ...]
    """To print before the parts: whether servo and horn fit."""
    findings: tuple[KitFinding, ...]
    """Faults first."""
    bill: tuple[BillLine, ...]

    @property
    def mass_g(self) -> float:
        """Of the whole robot: prints, servos and steel; without screws and cables."""
        return sum(line.mass_g for line in self.bill if line.mass_g is not None)

    @property
    def hull_mm3(self) -> float:
        """Volume of both pontoons' outlines, hollows included [mm³]."""
        area: float = sum(profile.face.area for profile in self.profiles)
        return 2 * self.settings.thickness_mm * area

    @property
    def printed_mm3(self) -> float:
        """Volume of the plastic's outside: what displaces water when every hollow is flooded, servos apart [mm³]."""
        return sum(part.volume_mm3 for part in self.parts)

    def direction(self, joint: int, side: str) -> Sense:
        """Give 1 if longer pulses turn a joint's child link counter-clockwise, seen with x to the right; else -1.

        Args:
            joint: number of its child link.
            side: the pontoon of the servo, left or right.
        """
        servo_joint = next(servo_joint for servo_joint in self.servo_joints if servo_joint.joint.link == joint)
        return servo_joint.direction(carrier_is_outer=self.layers.outer[servo_joint.carrier], side=side)


def build_kit(design: Designs, settings: KitSettings) -> Kit:
    """Make a design's parts and check them.

    Args:
        design: one valid design; joints whose motor is off are locked at rest.
        settings: scale, servo, clearances, printer.

    Raises:
        DesignError: the design is not valid.
        ServoError: the library has no such servo or horn.
        KitError: no part can be made with these settings.
        SolidError: the CAD kernel made something else than it was told.
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
