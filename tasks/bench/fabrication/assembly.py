"""The assembly: the outlines, layers, rods, pieces and hollows of all parts of one design."""

from dataclasses import dataclass

from shapely import Polygon, unary_union

from tasks.bench.fabrication.built_bodies import Mechanism, mechanism_of
from tasks.bench.fabrication.features import Feature, check_room_between, features_of
from tasks.bench.fabrication.kit_settings import KitSettings
from tasks.bench.fabrication.printing import ROD_CLEARANCE_MM
from tasks.bench.fabrication.profile import Profile, profile_of
from tasks.bench.fabrication.rods import Layers, keep_out, layers_of, rod_circles
from tasks.bench.fabrication.servo_joints import ServoJoint, servo_joints_of
from tasks.bench.fabrication.servos import Sense, Servo, as_measured
from tasks.bench.fabrication.splits import Split, split_of
from tasks.design import Designs
from tasks.design.genes import check

SIDES = ("left", "right")


@dataclass(frozen=True, eq=False)
class Assembly:
    """A robot to build. The left pontoon is on the left of a robot that moves along +x with +y up; z starts there."""

    settings: KitSettings
    mechanism: Mechanism
    servo: Servo  # of every joint, with its one horn and the user's measurements
    servo_joints: tuple[ServoJoint, ...]  # one per turning joint, in order of the child links
    profiles: tuple[Profile, ...]  # one per body
    layers: Layers
    splits: tuple[Split, ...]  # one per body
    features: dict[tuple[int, str], tuple[Feature, ...]]
    """Features cut out of each copy of a body, by the body's index and the side."""

    @property
    def outlines(self) -> list[Polygon]:
        """Outlines of the parts, including bosses and fillets."""
        return [profile.polygon for profile in self.profiles]

    def placement(self, body: int, side: str) -> tuple[bool, float]:
        """Return whether a part made with its back at 0 and its face up is mirrored, and its shift along z [mm]."""
        outer, inward = self.layers.outer[body], self.layers.low_mm(body, self.settings)
        return (not outer, inward) if side == "left" else (outer, self.settings.pitch_mm - inward)

    def direction(self, servo_joint: ServoJoint, side: str) -> Sense:
        """Return 1 if longer pulses turn a joint (its child link) counter-clockwise, x to the right; else -1."""
        return servo_joint.direction(carrier_is_outer=self.layers.outer[servo_joint.carrier], side=side)


def assemble(design: Designs, settings: KitSettings) -> Assembly:
    """Lay out the parts of one design. Joints whose motor is off are locked at rest.

    Raises:
        DesignError: The design is invalid.
        KitError: No part can be made with these settings: there is no such servo or horn, the measurements contradict
            each other, something does not fit, or the CAD kernel made geometry that does not match the polygons.
    """
    check(design)
    mechanism = mechanism_of(design, settings)
    servo = as_measured(settings.servo, settings.horn, settings.measured)
    servo_joints = servo_joints_of(mechanism, servo, settings)
    check_room_between(servo_joints, settings)
    bodies = range(len(mechanism.bodies))
    profiles = tuple(profile_of(mechanism, servo_joints, body) for body in bodies)
    outlines = [profile.polygon for profile in profiles]
    layers = layers_of(mechanism, servo_joints, outlines, settings)
    bores = [rod_circles(rods, (settings.rod_mm + ROD_CLEARANCE_MM) / 2) for rods in layers.rods]
    taken = [unary_union([keep_out(servo_joints, body), bores[body]]) for body in bodies]
    return Assembly(
        settings=settings,
        mechanism=mechanism,
        servo=servo,
        servo_joints=servo_joints,
        profiles=profiles,
        layers=layers,
        splits=tuple(split_of(mechanism, body, outlines[body], taken[body], settings) for body in bodies),
        features={
            (body, side): features_of(body, side, servo_joints, layers.rods[body], settings)
            for body in bodies
            for side in SIDES
        },
    )
