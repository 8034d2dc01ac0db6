"""Parts against closed forms: areas, volumes and positions of holes of simple robots."""

from dataclasses import replace
from math import atan2, hypot, pi, sqrt

import numpy as np
import pytest
from build123d import GeomType
from shapely import Point

from tasks.bench.fabrication.built_bodies import Pose, mechanism_of, moved
from tasks.bench.fabrication.kit import Kit, build_kit
from tasks.bench.fabrication.kit_settings import KitSettings
from tasks.bench.fabrication.parts import mesh_of, on_bed
from tasks.bench.fabrication.printing import SWEEP_CLEARANCE_MM, WALL_MM

SETTINGS = KitSettings()
LINK = 140.0 * 35.0
SEAT = 10.0 + 0.3 + 3.0
"""Radius of the boss around a disc horn: horn, clearance and wall."""
CORNER = 1.0 - pi / 4
"""Area that a fillet of radius 1 adds in a right angle, or removes from one."""
EXACT = 1e-9
"""Relative tolerance; the kernel's areas of lines and arcs are exact too."""
IN_PLACE: Pose = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 0.0])


def part(kit: Kit, name: str):
    return next(p for p in kit.parts if p.name == name)


def fillet_between_line_and_disc(big: float, small: float) -> float:
    """Area of a fillet where a disc of radius ``big`` leaves a line through its middle at a right angle.

    The fillet's centre is ``small`` from the line and ``big + small`` from the disc's middle. The two sectors are
    subtracted from the right triangle of the two centres and the foot on the line.
    """
    foot = sqrt(big * big + 2 * big * small)
    angle = atan2(small, foot)
    return foot * small / 2 - big * big * angle / 2 - small * small * (pi / 2 - angle) / 2


def test_outlines_with_bosses_and_fillets(kit):
    # A cradle is 20 + 2·(0.3 + 3) = 26.6 wide and reaches 10 + 7 + 0.3 + 3 = 20.3 beyond the joint at its link's end.
    # Its own corners are rounded with the wall's 3 mm. Beside it the link's end is 4.2 mm long: room for 2.5, not 5.
    cradle = 26.6 * 20.3 - 2 * CORNER * 3.0**2 + 2 * CORNER * 2.5**2
    assert kit.profiles[0].face.area == pytest.approx(2 * LINK - 35**2 + 4 * CORNER * 25 + 2 * cradle, rel=EXACT)
    # A horn's seat is half a disc beyond the link's end.
    seat = pi * SEAT**2 / 2 + 2 * fillet_between_line_and_disc(SEAT, 2.5)
    for profile in kit.profiles[1:]:
        assert profile.face.area == pytest.approx(2 * LINK - 17.5**2 + 2 * CORNER * 25 + seat, rel=EXACT)


def holes(solid, radius: float):
    """Return the positions in the plane of the round holes of a radius."""
    cylinders = [f for f in solid.faces() if f.geom_type == GeomType.CYLINDER]
    faces = [f for f in cylinders if f.radius is not None and abs(f.radius - radius) < 1e-9]  # None: not all around
    return sorted({(round(f.axis_of_rotation.position.X, 6), round(f.axis_of_rotation.position.Y, 6)) for f in faces})


def test_places_of_holes(kit):
    # Joint 2 is at (0, 70); its servo lies along link 0, downward: its middle is 40 / 2 - 10 = 10 below.
    ears = [(x, 70 - 10.0 + end) for x in (-5.0, 5.0) for end in (-24.75, 24.75)]
    assert np.allclose(holes(part(kit, "part-1-left").solid, 1.275), sorted(ears))
    # The horn's screws are 7 mm from the shaft, the centre screw's hole on it.
    assert np.allclose(holes(part(kit, "part-2-left").solid, 1.7), sorted([(-7, 70), (7, 70), (0, 63), (0, 77)]))
    assert np.allclose(holes(part(kit, "part-2-left").solid, 3.5), [(0, 70)])
    for body, rods in enumerate(kit.layers.rods):
        for side in ("left", "right"):
            bores = holes(part(kit, f"part-{body + 1}-{side}").solid, 1.55)
            assert all(any(hypot(x - a, y - b) < 1e-5 for a, b in bores) for x, y in rods)


def test_servos_alternate_between_the_pontoons_and_pins_replace_the_others(kit, crane):
    names = sorted(item.name for item in kit.bought if item.kind in ("servo", "pin"))
    pins = ["pin of joint 2, right", "pin of joint 4, left"]
    assert names == [*pins, "servo of joint 2, left", "servo of joint 4, right"]
    both = build_kit(crane, SETTINGS.model_copy(update={"servos_per_joint": 2}))
    assert sum(item.kind == "servo" for item in both.bought) == 4 and not any(b.kind == "pin" for b in both.bought)


def test_nothing_overlaps_in_the_assembled_robot(kit):
    """Parts, servos, horns and rods may touch but not overlap."""
    things = [(p.name, p.solid) for p in kit.parts] + [(b.name, b.solid) for b in kit.bought]
    for n, (name, solid) in enumerate(things):
        for other_name, other in things[n + 1 :]:
            shared = solid.intersect(other)
            volume = 0.0 if shared is None else sum(s.volume for s in shared.solids())
            assert volume < 1e-3, f"{name} and {other_name} share {volume:.2f} mm³"


def test_rods_reach_both_copies_and_clear_the_sweeping_parts(kit):
    for body, rods in enumerate(kit.layers.rods):
        assert len(rods) == 2
        for rod in rods:
            wall = kit.profiles[body].polygon.boundary.distance(Point(rod)) - 1.55
            assert wall > WALL_MM - 0.01
            for other in kit.mechanism.bodies:
                if kit.layers.outer[body] and not kit.layers.outer[other.index]:
                    for pose in kit.mechanism.poses_in_range(body, other.index):
                        gap = moved(kit.profiles[other.index].polygon, pose).distance(Point(rod)) - 1.5
                        assert gap > SWEEP_CLEARANCE_MM - 0.01


def test_poses_are_those_of_the_design_with_its_joints_turned(crane):
    """The reference is independent: the tree at rest, with each turn added to its rest angle."""
    mechanism = mechanism_of(crane, SETTINGS)
    instants = 2 * pi * np.arange(96) / 96
    for instant in (0, 7, 40):
        turn = crane.motor_on * crane.motion_range * np.sin(instants[instant] + crane.phase)
        expected = mechanism_of(replace(crane, rest_angle=crane.rest_angle + turn), SETTINGS)
        for body in mechanism.bodies:
            pose = mechanism.poses_in_gait(0, body.index)[instant] if body.index else IN_PLACE
            here = moved(body.outline, pose)
            assert here.symmetric_difference(expected.bodies[body.index].outline).area < 1e-6
    across = mechanism.poses_in_gait(1, 2)[7]  # up one joint and down another
    root = [mechanism.poses_in_gait(0, body)[7] for body in (1, 2)]
    seen = moved(moved(mechanism.bodies[2].outline, across), root[0])
    assert seen.symmetric_difference(moved(mechanism.bodies[2].outline, root[1])).area < 1e-6


def test_the_bill(kit):
    lines = {(line.kind, line.item, line.length_mm): line for line in kit.bill}
    rod = "stainless steel rod, 3 mm"
    outer = sum(kit.layers.outer)
    assert lines["rod", rod, 325.0].count == 2 * outer and lines["rod", rod, 273.0].count == 2 * (3 - outer)
    assert lines["pin", rod, 51.0].count == 2
    assert lines["rod", rod, 325.0].mass_g == pytest.approx(2 * outer * 7.9e-3 * pi * 1.5**2 * 325)
    assert lines["servo", "ds3225 with a disc horn", None].count == 2
    # Ears of 2.5 mm on a plate of 10: 12.5 mm. A disc of 2.5, 5 mm of web and the tip: 8.
    assert lines["screw", "M3 self-tapping × 12", None].count == 8
    (horn_screws,) = (line for line in kit.bill if line.note == "horn")
    assert (horn_screws.item, horn_screws.count) == ("M3 × 8", 8)
    printed = part(kit, "part-2-right")
    shell = printed.solid.area * 0.8
    assert printed.mass_g == pytest.approx(1.24e-3 * (shell + 0.45 * (printed.solid.volume - shell)))
    assert kit.mass_g == pytest.approx(
        sum(p.mass_g for p in kit.parts) + 2 * 67 + sum(line.mass_g for line in kit.bill if line.kind in ("rod", "pin"))
    )


def test_a_part_with_a_servo_is_printed_with_its_pocket_upward(kit):
    # 54.6 × 20.6 is missing at the height of the back.
    lying = on_bed(part(kit, "part-1-left"), mesh_of(part(kit, "part-1-left").solid))
    a, b, c = (lying.vertices[lying.triangles[:, corner]] for corner in range(3))
    area = np.cross(b - a, c - a)[:, 2] / 2
    top = area[(np.abs(np.stack([a, b, c])[:, :, 2] - 25.0) < 1e-6).all(axis=0)].sum()
    expected = kit.profiles[0].face.area - 54.6 * 20.6 - 2 * 5.0 * 3.0 - 3 * pi * 1.55**2
    assert top == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(
    ("outer", "side", "shaft_z"), [(True, "left", 1), (True, "right", -1), (False, "left", -1), (False, "right", 1)]
)
def test_the_sense_of_a_servo(kit, outer, side, shaft_z):
    """The horn turns by `sense` about the shaft, along +z or -z, together with the child or the parent."""
    for servo_joint in kit.servo_joints:
        for carrier, child_turns in ((servo_joint.joint.parent, 1), (servo_joint.joint.child, -1)):
            direction = replace(servo_joint, carrier=carrier).direction(carrier_is_outer=outer, side=side)
            assert direction == servo_joint.servo.sense * shaft_z * child_turns


def test_the_shaft_of_a_servo_points_to_its_horn(kit):
    for servo_joint in kit.servo_joints:  # away from the carrier's back
        for where in servo_joint.sides:
            horn = next(b for b in kit.bought if b.name == f"horn of joint {servo_joint.joint.link}, {where}").solid
            carrier = part(kit, f"part-{servo_joint.carrier + 1}-{where}").solid
            points_up = horn.bounding_box().center().Z > carrier.bounding_box().center().Z
            assert points_up == (kit.layers.outer[servo_joint.carrier] == (where == "left"))
