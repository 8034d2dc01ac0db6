"""Parts against closed forms: areas, volumes and the places of holes, for robots that one can work out by heart."""

from dataclasses import replace
from itertools import pairwise
from math import atan2, degrees, hypot, pi, radians, sqrt

import numpy as np
import pytest
from build123d import GeomType
from shapely import Point, unary_union

from tasks.design import N_LINKS, DesignError, Designs, random_designs
from tasks.fabrication.checks import lag_rad
from tasks.fabrication.drives import drives_of
from tasks.fabrication.features import KitError, horn_features
from tasks.fabrication.kit import Kit, build_kit
from tasks.fabrication.parts import mesh_of, on_bed
from tasks.fabrication.rigid import IN_PLACE, mechanism_of, moved
from tasks.fabrication.servos import SERVOS, ServoError, servo_named
from tasks.fabrication.settings import KitSettings

SETTINGS = KitSettings()
LINK = 140.0 * 35.0
SEAT = 10.0 + 0.3 + 3.0
"""Radius of the boss around a disc horn: horn, clearance, wall."""
CORNER = 1.0 - pi / 4
"""Area that a fillet of radius 1 adds in a right angle, or a rounding takes from one."""
EXACT = 1e-9
"""Relative. The kernel's areas of lines and arcs are closed forms too."""


def part(kit: Kit, name: str):
    return next(p for p in kit.parts if p.name == name)


def found(kit: Kit, name: str):
    return [finding for finding in kit.findings if finding.name == name]


def with_genes(design: Designs, **genes) -> Designs:
    return replace(design, **{name: np.asarray(value) for name, value in genes.items()})


@pytest.fixture(scope="module")
def kit(crane) -> Kit:
    return build_kit(crane, SETTINGS)


def fillet_between_line_and_disc(big: float, small: float) -> float:
    """Area of a fillet where a disc of radius ``big`` leaves a line through its middle at a right angle.

    The fillet's centre is ``small`` from the line and ``big + small`` from the disc's middle. Of the right triangle of
    the two centres and the foot on the line, the two sectors are taken away.
    """
    foot = sqrt(big * big + 2 * big * small)
    angle = atan2(small, foot)
    return foot * small / 2 - big * big * angle / 2 - small * small * (pi / 2 - angle) / 2


def test_links_whose_joint_is_locked_are_one_part(kit):
    assert [body.links for body in kit.mechanism.bodies] == [(0, 1), (2, 3), (4, 5)]
    assert [(j.link, j.parent, j.child) for j in kit.mechanism.joints] == [(2, 0, 1), (4, 0, 2)]
    assert np.allclose([j.at for j in kit.mechanism.joints], [(0.0, 70.0), (70.0, 0.0)])
    areas = [body.outline.area for body in kit.mechanism.bodies]
    assert areas == pytest.approx([2 * LINK - 35**2] + 2 * [2 * LINK - 17.5**2])


def test_outlines_with_bosses_and_fillets(kit):
    # A cradle is 20 + 2·(0.3 + 3) = 26.6 wide and reaches 10.2 + 7 + 0.3 + 3 = 20.5 beyond the joint at its link's end.
    # Its own corners are rounded with the wall's 3 mm. Beside it the link's end is 4.2 mm long: room for 2.5, not 5.
    cradle = 26.6 * 20.5 - 2 * CORNER * 3.0**2 + 2 * CORNER * 2.5**2
    assert kit.profiles[0].face.area == pytest.approx(2 * LINK - 35**2 + 4 * CORNER * 25 + 2 * cradle, rel=EXACT)
    # A horn's seat is half a disc beyond the link's end.
    seat = pi * SEAT**2 / 2 + 2 * fillet_between_line_and_disc(SEAT, 2.5)
    for profile in kit.profiles[1:]:
        assert profile.face.area == pytest.approx(2 * LINK - 17.5**2 + 2 * CORNER * 25 + seat, rel=EXACT)


def test_volumes(kit):
    rod = pin = pi * 1.55**2 * 25
    plate = 38.0 - 28.0 - 2.5
    cradle = 55.1 * 20.6 * (25 - plate) + 41.1 * 20.6 * plate + 4 * pi * 1.275**2 * plate + 2 * 5.0 * 3.0 * 5.0
    assert part(kit, "part-1-left").volume_mm3 == pytest.approx(
        25 * kit.profiles[0].face.area - cradle - pin - 2 * rod, rel=EXACT
    )
    recess, through = 7.5 - 1.0, 25 - (7.5 - 1.0)
    horn = pi * 10.3**2 * recess + pi * (3.5**2 + 4 * 1.7**2) * through
    assert part(kit, "part-2-left").volume_mm3 == pytest.approx(
        25 * kit.profiles[1].face.area - horn - 2 * rod, rel=EXACT
    )
    turning = pi * 1.65**2 * 25
    assert part(kit, "part-2-right").volume_mm3 == pytest.approx(
        25 * kit.profiles[1].face.area - turning - 2 * rod, rel=EXACT
    )
    assert kit.hull_mm3 == pytest.approx(50 * sum(p.face.area for p in kit.profiles))


def holes(solid, radius: float):
    """Places in the plane of the round holes of a radius."""
    faces = [f for f in solid.faces() if f.geom_type == GeomType.CYLINDER and abs(f.radius - radius) < 1e-9]
    return sorted({(round(f.axis_of_rotation.position.X, 6), round(f.axis_of_rotation.position.Y, 6)) for f in faces})


def test_places_of_holes(kit):
    # Joint 2 is at (0, 70); its servo lies along link 0, downward: its middle is 40.5 / 2 - 10.2 = 10.05 below.
    ears = [(x, 70 - 10.05 + end) for x in (-5.0, 5.0) for end in (-24.75, 24.75)]
    assert np.allclose(holes(part(kit, "part-1-left").solid, 1.275), sorted(ears))
    # The horn's screws are 7 mm from the shaft, the centre screw's hole on it.
    assert np.allclose(holes(part(kit, "part-2-left").solid, 1.7), sorted([(-7, 70), (7, 70), (0, 63), (0, 77)]))
    assert np.allclose(holes(part(kit, "part-2-left").solid, 3.5), [(0, 70)])
    for body, rods in enumerate(kit.layers.rods):
        for side in ("left", "right"):
            bores = holes(part(kit, f"part-{body + 1}-{side}").solid, 1.55)
            assert all(any(hypot(x - a, y - b) < 1e-5 for a, b in bores) for x, y in rods)


def test_servos_go_left_and_right_by_turns_and_pins_stand_for_the_others(kit, crane):
    kinds = sorted(item.name for item in kit.bought if item.kind in ("servo", "pin"))
    assert kinds == [
        "pin of joint 2, right", "pin of joint 4, left", "servo of joint 2, left", "servo of joint 4, right",
    ]  # fmt: skip
    both = build_kit(crane, SETTINGS.model_copy(update={"servos_per_joint": 2}))
    assert sum(item.kind == "servo" for item in both.bought) == 4 and not any(b.kind == "pin" for b in both.bought)
    assert not found(both, "rods give way")


def test_pontoons_mirror_one_another_at_the_pitch(kit):
    for body, outer in enumerate(kit.layers.outer):
        left, right = (part(kit, f"part-{body + 1}-{side}").solid.bounding_box() for side in ("left", "right"))
        bottom = 0.0 if outer else 26.0
        came = [left.min.Z, left.max.Z, right.min.Z, right.max.Z]
        assert came == pytest.approx([bottom, bottom + 25.0, 300.0 - bottom, 325.0 - bottom], abs=1e-6)
    assert kit.layers.outer[0] != kit.layers.outer[1] == kit.layers.outer[2]


def test_nothing_overlaps_in_the_assembled_robot(kit):
    """Parts, servos, horns and rods: only a horn and its hub, and what is glued or screwed, may touch."""
    things = [(p.name, p.solid) for p in kit.parts] + [(b.name, b.solid) for b in kit.bought]
    for n, (name, solid) in enumerate(things):
        for other_name, other in things[n + 1 :]:
            shared = solid.intersect(other)
            volume = 0.0 if shared is None else sum(s.volume for s in shared.solids())
            assert volume < 1e-3, f"{name} and {other_name} share {volume:.2f} mm³"


def test_rods_reach_both_copies_and_miss_what_sweeps(kit):
    for body, rods in enumerate(kit.layers.rods):
        assert len(rods) == 2
        for rod in rods:
            wall = kit.profiles[body].polygon.boundary.distance(Point(rod)) - 1.55
            assert wall > SETTINGS.wall_mm - 0.01
            for other in kit.mechanism.bodies:
                if kit.layers.outer[body] and not kit.layers.outer[other.index]:
                    for pose in kit.mechanism.poses_in_range(body, other.index):
                        gap = moved(kit.profiles[other.index].polygon, pose).distance(Point(rod)) - 1.5
                        assert gap > SETTINGS.sweep_clearance_mm - 0.01
    for item in kit.bought:
        if item.kind == "rod":
            box, body = item.solid.bounding_box(), int(item.name[-1]) - 1
            left, right = (part(kit, f"part-{body + 1}-{side}").solid.bounding_box() for side in ("left", "right"))
            came = [box.min.Z, box.max.Z]
            assert came == pytest.approx([left.min.Z, right.max.Z])


def test_poses_are_those_of_the_design_with_its_joints_turned(crane):
    """Independent of the chain of turns: the pose of the tree at rest with each turn added to its rest angle."""
    mechanism = mechanism_of(crane, SETTINGS)
    instants = 2 * pi * np.arange(96) / 96
    for instant in (0, 7, 40):
        turned = crane.rest_angle + np.where(
            crane.motor_on, crane.motion_range * np.sin(instants[instant] + crane.phase), 0.0
        )
        expected = mechanism_of(with_genes(crane, rest_angle=turned), SETTINGS)
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
    # Ears of 2.5 mm on a plate of 7.5: 10 mm. 18.5 mm of part and a disc of 2.5: at most 21.
    assert lines["screw", "M3 self-tapping × 10", None].count == 8
    assert lines["screw", "M3 × 20", None].count == 8
    printed = part(kit, "part-2-right")
    shell = printed.solid.area * 0.8
    assert printed.mass_g == pytest.approx(1.24e-3 * (shell + 0.45 * (printed.volume_mm3 - shell)))
    assert kit.mass_g == pytest.approx(sum(p.mass_g for p in kit.parts) + 120 + sum(
        line.mass_g for line in kit.bill if line.kind in ("rod", "pin")
    ))


def test_parts_lie_on_the_bed(kit):
    for piece in kit.parts:
        lying = on_bed(piece, mesh_of(piece.solid))
        assert np.allclose(lying.vertices.min(axis=0), 0.0)
        assert np.allclose(lying.vertices[:, 2].max(), 25.0)
        assert (lying.vertices.max(axis=0)[:2] <= 210.0).all()
        a, b, c = (lying.vertices[lying.triangles[:, corner]] for corner in range(3))
        assert (np.cross(a, b) * c).sum() / 6 == pytest.approx(piece.volume_mm3, rel=2e-3)  # turned, not mirrored
    # The pocket of part 1 opens upward: at the height of the back, its rim is cut by 55.1 × 20.6.
    lying = on_bed(part(kit, "part-1-left"), mesh_of(part(kit, "part-1-left").solid))
    a, b, c = (lying.vertices[lying.triangles[:, corner]] for corner in range(3))
    area = np.cross(b - a, c - a)[:, 2] / 2
    top = area[(np.abs(np.stack([a, b, c])[:, :, 2] - 25.0) < 1e-6).all(axis=0)].sum()
    expected = kit.profiles[0].face.area - 55.1 * 20.6 - 2 * 5.0 * 3.0 - 3 * pi * 1.55**2
    assert top == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("outer", [True, False])
def test_the_sense_of_a_servo(kit, side, outer):
    """The horn turns by `sense` about the shaft, which is along +z or -z, and takes the child or the parent along."""
    for drive in kit.drives:
        for carrier in (drive.joint.parent, drive.joint.child):
            one = replace(drive, carrier=carrier, driven=drive.joint.parent + drive.joint.child - carrier)
            shaft_z = 1 if (outer == (side == "left")) else -1
            driven_turns = one.servo.sense * shaft_z
            child_turns = driven_turns if one.driven == one.joint.child else -driven_turns
            assert one.direction(carrier_is_outer=outer, side=side) == child_turns
    for drive in kit.drives:  # the shaft points where the horn is: away from the carrier's back
        for where in drive.sides(1):
            horn = next(b for b in kit.bought if b.name == f"horn of joint {drive.joint.link}, {where}").solid
            carrier = part(kit, f"part-{drive.carrier + 1}-{where}").solid
            points_up = horn.bounding_box().center().Z > carrier.bounding_box().center().Z
            assert points_up == (kit.layers.outer[drive.carrier] == (where == "left"))


# Findings


def test_a_sound_robot_has_no_fault(kit):
    assert kit.faults == ()


def test_not_of_the_variant(crane):
    still = build_kit(with_genes(crane, motor_on=np.zeros((1, N_LINKS), dtype=bool)), SETTINGS)
    assert len(still.mechanism.bodies) == 1 and not still.drives and len(still.layers.rods[0]) == 2
    assert "0 motors are on" in found(still, "not of the variant")[0].message
    # Link 2 folded down over link 0 covers the left or right of link 1's middle too: 35 × 35 mm.
    folded = build_kit(with_genes(crane, rest_angle=np.array([[0, -pi / 2, pi, -pi / 2, 0, -pi / 2]])), SETTINGS)
    said = {finding.where: finding.message for finding in found(folded, "not of the variant")}
    assert "overlap by 1225 mm² at rest without being joined" in said["links 1 and 2"]


def test_every_number_of_motors(crane):
    for n in (1, 3, 5):
        on = np.array([[False] + [True] * n + [False] * (5 - n)])
        several = build_kit(with_genes(crane, motor_on=on), SETTINGS.model_copy(update={"servo": "mg90s"}))
        assert len(several.drives) == n and len(several.mechanism.bodies) == n + 1
        depth = [body.depth for body in several.mechanism.bodies]
        assert all((depth[j.parent] - depth[j.child]) % 2 == 1 for j in several.mechanism.joints)


def test_a_servo_that_does_not_turn_far_enough(crane):
    wide = with_genes(crane, motion_range=np.array([[0, 0.2, radians(61), 0.2, radians(59), 0.2]]))
    limited = build_kit(wide, SETTINGS.model_copy(update={"servo": "hs85mg", "horn": "cross"}))
    (finding,) = found(limited, "servo's travel")
    assert (finding.severity, finding.where) == ("fault", "joint 2") and "±61°" in finding.message


def test_a_cradle_wider_than_its_link(crane):
    slim = build_kit(with_genes(crane, length_scale=np.full((1, N_LINKS), 3.0)), SETTINGS)
    (first, second) = found(slim, "cradle wider than its link")
    assert "26.6 mm wide, link 0 23.3" in first.message and second.where == "joint 4"


def test_servos_in_one_place(crane):
    twin = build_kit(with_genes(crane, parent=np.array([[-1, 0, 0, 2, 0, 4]]),
                                parent_attachment=np.array([[0, 0, 1, 1, 0.9, 1.0]])), SETTINGS)  # fmt: skip
    (finding,) = found(twin, "servos in one place")
    assert finding.severity == "fault" and "7.0 mm apart on part 1" in finding.message  # 0.1 · 70 mm


def test_walls(crane):
    # From an ear's screw, 27.8 / 2 from the servo's middle, to the case's opening, 22.8 / 2 + 0.3, less the pilot.
    wall = 27.8 / 2 - 22.8 / 2 - 0.3 - 0.85 * 2.0 / 2
    micro = SETTINGS.model_copy(update={"servo": "mg90s"})
    thick = build_kit(crane, micro.model_copy(update={"min_wall_mm": wall + 0.01}))
    (left, right) = found(thick, "wall too thin")
    assert f"{wall:.2f} mm between case" in left.message and left.where != right.where
    thin = build_kit(crane, micro.model_copy(update={"min_wall_mm": wall - 0.01}))
    assert not found(thin, "wall too thin")


def test_necks(crane):
    # Links 2 and 3 overlap in a square of 17.5: its diagonal, and twice what a fillet of radius 5 adds in its corners.
    neck = 17.5 * sqrt(2) + 2 * 5 * (sqrt(2) - 1)
    for least, expected in ((neck - 0.3, 0), (neck + 0.3, 2)):
        kit = build_kit(crane, SETTINGS.model_copy(update={"min_neck_mm": least}))
        assert len(found(kit, "narrow neck")) == expected


def test_parts_that_collide(crane):
    # Clockwise turns bring part 2 down and counter-clockwise ones bring part 3 up, towards one another.
    for phase, severity, said in ((0.0, "warning", "miss one another in the gait"), (pi, "fault", "meet in the gait")):
        far = with_genes(crane, motion_range=np.array([[0, 0.2, 1.2, 0.2, 1.2, 0.2]]),
                         phase=np.array([[0, 0, 0, 0, phase, 0]]))  # fmt: skip
        (finding,) = found(build_kit(far, SETTINGS), "parts collide")
        assert (finding.severity, finding.where) == (severity, "part 2 and part 3")
        assert said in finding.message and "joint 2 and joint 4" in finding.message
    at_rest = with_genes(crane, rest_angle=np.array([[0, -pi / 2, -2.2, -pi / 2, 0.8, -pi / 2]]))
    (finding,) = found(build_kit(at_rest, SETTINGS), "parts collide")
    assert finding.severity == "fault" and "at rest" in finding.message


def test_no_room_for_rods(crane):
    # Two equal links joined at their middles, each of which sweeps over all of the other.
    flat = with_genes(crane, parent=np.array([[-1, 0, 0, 0, 0, 0]]), parent_attachment=np.zeros((1, 6)),
                      child_attachment=np.zeros((1, 6)), rest_angle=np.array([[0, 0, 0, 0, 0, pi / 2]]),
                      motor_on=np.array([[False] * 5 + [True]]),
                      motion_range=np.array([[0, 0.2, 0.2, 0.2, 0.2, pi / 2]]))  # fmt: skip
    kit = build_kit(flat, SETTINGS)
    (finding,) = found(kit, "no room for rods")
    assert finding.severity == "fault" and sorted(map(len, kit.layers.rods)) == [0, 2]


def test_rods_that_give_way(kit):
    # 12 E I / L³ with L = 275 mm for an outer part and 223 for an inner one; half of 21 kg·cm on the other pontoon.
    drive = kit.drives[0]
    lag = 0.0
    for body in (0, 1):
        free = 0.275 if kit.layers.outer[body] else 0.223
        stiffness = 12 * 193e9 * (pi * 0.003**4 / 64) / free**3
        lever2 = sum((x / 1000) ** 2 + ((y - 70.0) / 1000) ** 2 for x, y in kit.layers.rods[body])
        lag += (21.0 * 0.0980665 / 2) / (stiffness * lever2)
    assert lag_rad(drive, kit.layers, SETTINGS) == pytest.approx(lag)
    said = [finding for finding in found(kit, "rods give way") if finding.where == "joint 2"]
    assert bool(said) == (lag > radians(10)) and all(f"{degrees(lag):.0f}°" in finding.message for finding in said)


def test_a_part_larger_than_the_bed_is_split_by_dovetails(crane):
    small = SETTINGS.model_copy(update={"bed_mm": (120.0, 120.0, 200.0)})
    kit = build_kit(crane, small)
    assert {finding.severity for finding in found(kit, "larger than the bed")} == {"note"}
    whole = build_kit(crane, SETTINGS)
    for body, split in enumerate(kit.splits):
        assert split.fits and len(split.pieces) > 1
        gap = unary_union(split.cuts).intersection(kit.profiles[body].polygon)
        for side in ("left", "right"):
            pieces = [p for p in kit.parts if p.body == body and p.side == side]
            assert len(pieces) == len(split.pieces)
            lost = part(whole, f"part-{body + 1}-{side}").volume_mm3 - sum(p.volume_mm3 for p in pieces)
            assert lost == pytest.approx(25 * gap.area, rel=1e-4)  # the outline's arcs are chords there
            assert all((on_bed(p, mesh_of(p.solid)).vertices.max(axis=0) <= [110, 110, 26]).all() for p in pieces)
        for a, b in pairwise(split.pieces):
            assert a.distance(b) >= small.split_clearance_mm - 1e-6
        # A dovetail holds: drawn apart along the link, the pieces meet.
        assert any(moved(a, np.array([1, 0, 0, 1, dx, dy])).intersects(b)
                   for a in split.pieces for b in split.pieces if a is not b
                   for dx, dy in ((2, 0), (-2, 0), (0, 2), (0, -2)))  # fmt: skip


def test_a_part_that_no_cut_makes_fit_is_refused_with_the_reason(crane):
    tiny = build_kit(crane, SETTINGS.model_copy(update={"bed_mm": (40.0, 40.0, 20.0)}))
    said = found(tiny, "larger than the bed")
    assert [finding.severity for finding in said] == 4 * ["fault"]
    assert "25 mm high, the printer 20" in said[0].message and "no straight cut" in said[1].message


# What is refused


def test_unknown_servos_and_horns_are_refused_with_the_list():
    with pytest.raises(ServoError, match=r"servo 'sg5010' is unknown, expected one of ds3225, hs85mg, mg90s"):
        servo_named("sg5010")
    disc = replace(SERVOS["ds3225"], horns=SERVOS["ds3225"].horns[:1])
    with pytest.raises(ServoError, match="has no cross horn, expected disc"):
        disc.horn("cross")


def test_settings_that_no_part_can_be_made_with(crane):
    # A plate of 29.9 - 18.5 - 2 = 9.4 mm, ears of 2 mm and a notch of 5 mm for the cable.
    with pytest.raises(KitError, match=r"thickness_mm is 15: servo hs85mg needs at least 16\.4"):
        build_kit(crane, KitSettings(thickness_mm=15.0, servo="hs85mg"))
    (drive, _) = drives_of(mechanism_of(crane, SETTINGS), SETTINGS)
    with pytest.raises(KitError, match=r"thickness_mm is 15: the horn of servo wide needs at least 26"):
        tall = replace(SERVOS["ds3225"].horns[0], top_mm=21.0)
        horn_features(replace(drive, horn=tall, servo=replace(SERVOS["ds3225"], name="wide")),
                      KitSettings(thickness_mm=15.0))  # fmt: skip
    # Two layers of 100 mm and their gap of 1 on either side leave less than nothing of 300 + 100.
    with pytest.raises(KitError, match=r"pitch_mm is 300: .* leave -2\.0 mm"):
        build_kit(crane, KitSettings(thickness_mm=100.0, servo="mg90s"))
    with pytest.raises(DesignError, match="length_scale of link 0 is 5"):
        build_kit(with_genes(crane, length_scale=np.array([[5.0, 2, 2, 2, 2, 2]])), SETTINGS)


def test_servos_are_what_their_sources_say():
    standard = SERVOS["ds3225"]
    assert standard.stall_torque_nm == pytest.approx(2.059, abs=1e-3)  # 21 kg·cm
    assert standard.no_load_speed_rad_s == pytest.approx(6.981, abs=1e-3)  # 60° in 0.15 s
    assert standard.torque_at(0.0) == standard.stall_torque_nm and standard.torque_at(-7.0) == 0.0
    assert standard.torque_at(standard.no_load_speed_rad_s / 2) == pytest.approx(standard.stall_torque_nm / 2)
    for servo in SERVOS.values():
        assert servo.source and servo.min_pulse_us < servo.neutral_us < servo.max_pulse_us
        assert servo.length_mm < servo.hole_span_mm < servo.ear_length_mm and servo.ear_bottom_mm < servo.height_mm
        for horn in servo.horns:  # screws on the horn, clear of its hub's middle
            assert servo.centre_screw_mm / 2 < horn.screw_radius_mm - horn.screw_mm / 2
            assert horn.screw_radius_mm + horn.screw_mm / 2 < min(horn.reach_mm)


# Random designs


def variant(rng: np.random.Generator) -> Designs:
    """Draw a design of the physical variant: two motors, and no links that overlap at rest without being joined."""
    while True:
        drawn = random_designs(64, rng)
        on = np.zeros((64, N_LINKS), dtype=bool)
        for row in on:
            row[1 + rng.choice(N_LINKS - 1, 2, replace=False)] = True
        for index in range(64):
            one = replace(drawn, motor_on=on)[[index]]
            links = mechanism_of(one, SETTINGS).links
            pairs = ((i, j) for j in range(N_LINKS) for i in range(j) if one.parent[0, j] != i)
            if not any(links[i].intersects(links[j]) for i, j in pairs):
                return one


def n_random(config: pytest.Config) -> int:
    return 200 if config.getoption("--torture", default=False) else 3


@pytest.mark.timeout(7200)  # under --torture there are 200
def test_random_designs_of_the_variant_make_valid_closed_parts(pytestconfig):
    """What build_kit itself holds: valid solids of the analytic volume. Here, that their meshes are closed too."""
    for seed in range(n_random(pytestconfig)):
        print(f"design {seed} of the variant")
        kit = build_kit(variant(np.random.default_rng([5, seed])), SETTINGS)
        assert len(kit.mechanism.bodies) == 3 and not found(kit, "not of the variant")
        check_meshes(kit)


@pytest.mark.timeout(7200)  # under --torture there are 200
def test_random_designs_of_any_kind_are_reported_on_not_crashed_on(pytestconfig):
    for seed in range(n_random(pytestconfig)):
        print(f"design {seed} of any kind")
        rng = np.random.default_rng([6, seed])
        servo = sorted(SERVOS)[seed % 3]
        settings = KitSettings(servo=servo, horn=("cross", "disc")[seed % 2], servos_per_joint=1 + seed % 2)
        check_meshes(build_kit(random_designs(1, rng), settings))


def check_meshes(kit: Kit) -> None:
    """Every edge is between two triangles that run along it in opposite directions."""
    for piece in kit.parts:
        mesh = mesh_of(piece.solid)
        edges = np.concatenate([mesh.triangles[:, [0, 1]], mesh.triangles[:, [1, 2]], mesh.triangles[:, [2, 0]]])
        there, back = (set(map(tuple, way.tolist())) for way in (edges, edges[:, ::-1]))
        assert len(there) == len(edges) and there == back, piece.name
