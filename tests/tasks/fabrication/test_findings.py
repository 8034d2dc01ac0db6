"""Findings of the checks, for robots with deliberate faults, and settings that are refused."""

from dataclasses import replace
from itertools import pairwise
from math import degrees, pi, radians, sqrt

import numpy as np
import pytest
from shapely import unary_union

from tasks.design import N_LINKS, DesignError, Designs
from tasks.fabrication import checks
from tasks.fabrication.assembly import Assembly, assemble
from tasks.fabrication.built_bodies import mechanism_of, moved
from tasks.fabrication.checks import lag_rad
from tasks.fabrication.features import KitError, horn_features
from tasks.fabrication.kit import Kit, build_kit
from tasks.fabrication.kit_settings import KitSettings
from tasks.fabrication.parts import mesh_of, on_bed
from tasks.fabrication.servo_joints import servo_joints_of
from tasks.fabrication.servos import SERVOS

SETTINGS = KitSettings()


def part(kit: Kit, name: str):
    return next(p for p in kit.parts if p.name == name)


def found(assembly: Assembly, name: str):
    return [finding for finding in checks.findings_of(assembly) if finding.name == name]


def with_genes(design: Designs, **genes) -> Designs:
    return replace(design, **{name: np.asarray(value) for name, value in genes.items()})


def test_a_sound_robot_has_no_fault(kit):
    assert not any(finding.severity == "fault" for finding in kit.findings)


def test_not_of_the_variant(crane):
    still = assemble(with_genes(crane, motor_on=np.zeros((1, N_LINKS), dtype=bool)), SETTINGS)
    assert len(still.mechanism.bodies) == 1 and not still.servo_joints and len(still.layers.rods[0]) == 2
    assert "0 motors are on" in found(still, "not of the variant")[0].message
    # Link 2 folded down over link 0 covers the left or right of link 1's middle too: 35 × 35 mm.
    folded = assemble(with_genes(crane, rest_angle=np.array([[0, -pi / 2, pi, -pi / 2, 0, -pi / 2]])), SETTINGS)
    said = {finding.where: finding.message for finding in found(folded, "not of the variant")}
    assert "overlap by 1225 mm² at rest without a joint" in said["links 1 and 2"]


def test_every_number_of_motors(crane):
    for n in (1, 3, 5):
        on = np.array([[False] + [True] * n + [False] * (5 - n)])
        several = assemble(with_genes(crane, motor_on=on), SETTINGS.model_copy(update={"servo": "mg90s"}))
        assert len(several.servo_joints) == n and len(several.mechanism.bodies) == n + 1
        depth = [body.depth for body in several.mechanism.bodies]
        assert all((depth[j.parent] - depth[j.child]) % 2 == 1 for j in several.mechanism.joints)


def test_a_servo_that_does_not_turn_far_enough(crane):
    wide = with_genes(crane, motion_range=np.array([[0, 0.2, radians(61), 0.2, radians(59), 0.2]]))
    limited = assemble(wide, SETTINGS.model_copy(update={"servo": "hs85mg", "horn": "cross"}))
    (finding,) = found(limited, "servo's travel")
    assert (finding.severity, finding.where) == ("fault", "joint 2") and "±61°" in finding.message


def test_a_cradle_wider_than_its_link(crane):
    slim = assemble(with_genes(crane, length_scale=np.full((1, N_LINKS), 3.0)), SETTINGS)
    (first, second) = found(slim, "cradle wider than its link")
    assert "26.6 mm wide, link 0 only 23.3 mm" in first.message and second.where == "joint 4"


def test_servos_in_one_place(crane):
    twin = assemble(
        with_genes(crane, parent=np.array([[-1, 0, 0, 2, 0, 4]]), parent_attachment=np.array([[0, 0, 1, 1, 0.9, 1.0]])),
        SETTINGS,
    )
    (finding,) = found(twin, "servos in one place")
    assert finding.severity == "fault" and "7.0 mm apart on part 1" in finding.message  # 0.1 · 70 mm


def test_servos_on_one_axis(kit):
    first, second = kit.servo_joints
    moved = replace(second, joint=replace(second.joint, at=first.joint.at))
    (finding,) = checks.shared_space(replace(kit, servo_joints=(first, moved)))
    assert finding.message.startswith("turn about one axis on part 1: their pockets overlap by ")


def test_walls(crane):
    # From an ear's screw, 28.3 / 2 from the servo's middle, to the case's opening, 22.8 / 2 + 0.3, less the pilot.
    wall = 28.3 / 2 - 22.8 / 2 - 0.3 - 0.85 * 2.0 / 2
    micro = SETTINGS.model_copy(update={"servo": "mg90s"})
    thick = assemble(crane, micro.model_copy(update={"min_wall_mm": wall + 0.01}))
    (left, right) = found(thick, "wall too thin")
    assert f"{wall:.2f} mm between case" in left.message and left.where != right.where
    thin = assemble(crane, micro.model_copy(update={"min_wall_mm": wall - 0.01}))
    assert not found(thin, "wall too thin")


def test_necks(crane):
    # Links 2 and 3 overlap in a square of 17.5: its diagonal, and twice what a fillet of radius 5 adds in its corners.
    neck = 17.5 * sqrt(2) + 2 * 5 * (sqrt(2) - 1)
    for least, expected in ((neck - 0.3, 0), (neck + 0.3, 2)):
        kit = assemble(crane, SETTINGS.model_copy(update={"min_neck_mm": least}))
        assert len(found(kit, "narrow neck")) == expected


def test_parts_that_collide(crane):
    # Clockwise turns bring part 2 down and counter-clockwise ones bring part 3 up, towards one another.
    for phase, severity, said in (
        (0.0, "warning", "clear one another in the gait"),
        (pi, "fault", "mm² in the gait, with"),
    ):
        far = with_genes(
            crane, motion_range=np.array([[0, 0.2, 1.2, 0.2, 1.2, 0.2]]), phase=np.array([[0, 0, 0, 0, phase, 0]])
        )
        (finding,) = found(assemble(far, SETTINGS), "parts collide")
        assert (finding.severity, finding.where) == (severity, "part 2 and part 3")
        assert said in finding.message and "joint 2 and joint 4" in finding.message
        assert ("Reduce motion_range" in finding.message) == (severity == "fault")
    at_rest = with_genes(crane, rest_angle=np.array([[0, -pi / 2, -2.2, -pi / 2, 0.8, -pi / 2]]))
    (finding,) = found(assemble(at_rest, SETTINGS), "parts collide")
    assert finding.severity == "fault" and "at rest" in finding.message and "rest_angle" in finding.message


def test_no_room_for_rods(crane):
    # Two equal links joined at their middles, each of which sweeps over all of the other.
    flat = with_genes(
        crane,
        parent=np.array([[-1, 0, 0, 0, 0, 0]]),
        parent_attachment=np.zeros((1, 6)),
        child_attachment=np.zeros((1, 6)),
        rest_angle=np.array([[0, 0, 0, 0, 0, pi / 2]]),
        motor_on=np.array([[False] * 5 + [True]]),
        motion_range=np.array([[0, 0.2, 0.2, 0.2, 0.2, pi / 2]]),
    )
    kit = assemble(flat, SETTINGS)
    (finding,) = found(kit, "no room for rods")
    assert finding.severity == "fault" and sorted(map(len, kit.layers.rods)) == [0, 2]


def test_rods_that_give_way(kit):
    # 12 E I / L³ with L = 275 mm for an outer part and 223 for an inner one; half of 21 kg·cm on the other pontoon.
    servo_joint = kit.servo_joints[0]
    lag = 0.0
    for body in (0, 1):
        free = 0.275 if kit.layers.outer[body] else 0.223
        stiffness = 12 * 193e9 * (pi * 0.003**4 / 64) / free**3
        lever2 = sum((x / 1000) ** 2 + ((y - 70.0) / 1000) ** 2 for x, y in kit.layers.rods[body])
        lag += (21.0 * 0.0980665 / 2) / (stiffness * lever2)
    assert lag_rad(kit, servo_joint) == pytest.approx(lag)
    said = [finding for finding in found(kit, "rods give way") if finding.where == "joint 2"]
    assert bool(said) == (lag > radians(10)) and all(f"{degrees(lag):.0f}°" in finding.message for finding in said)


def test_a_part_larger_than_the_bed_is_split_by_dovetails(crane, kit):
    small = SETTINGS.model_copy(update={"bed_mm": (120.0, 120.0, 200.0)})
    cut = build_kit(crane, small)
    assert {finding.severity for finding in found(cut, "larger than the bed")} == {"note"}
    for body, split in enumerate(cut.splits):
        assert split.fits and len(split.pieces) > 1
        gap = unary_union(split.cuts).intersection(cut.profiles[body].polygon)
        for side in ("left", "right"):
            pieces = [p for p in cut.parts if p.body == body and p.side == side]
            assert len(pieces) == len(split.pieces)
            lost = part(kit, f"part-{body + 1}-{side}").volume_mm3 - sum(p.volume_mm3 for p in pieces)
            assert lost == pytest.approx(25 * gap.area, rel=1e-4)  # the outline's arcs are chords there
            assert all((on_bed(p, mesh_of(p.solid)).vertices.max(axis=0) <= [110, 110, 26]).all() for p in pieces)
        for a, b in pairwise(split.pieces):
            assert a.distance(b) >= small.split_clearance_mm - 1e-6
        # The dovetail holds: the pieces collide when pulled apart along the link.
        assert any(
            moved(a, np.array([1, 0, 0, 1, dx, dy])).intersects(b)
            for a in split.pieces
            for b in split.pieces
            if a is not b
            for dx, dy in ((2, 0), (-2, 0), (0, 2), (0, -2))
        )


def test_a_part_that_no_cut_makes_fit_is_a_fault(crane):
    tiny = assemble(crane, SETTINGS.model_copy(update={"bed_mm": (40.0, 40.0, 20.0)}))
    said = found(tiny, "larger than the bed")
    assert [finding.severity for finding in said] == 4 * ["fault"]
    assert (
        "25 mm high, but the printer reaches only 20 mm" in said[0].message
        and "No cut across a link" in said[1].message
    )


def test_settings_that_no_part_can_be_made_with(crane):
    # A plate of 29.9 - 18.5 - 2 = 9.4 mm, ears of 2 mm and a notch of 5 mm for the cable.
    with pytest.raises(KitError, match=r"thickness_mm is 15: servo hs85mg needs at least 16\.4"):
        assemble(crane, KitSettings(thickness_mm=15.0, servo="hs85mg"))
    (servo_joint, _) = servo_joints_of(mechanism_of(crane, SETTINGS), SETTINGS)
    with pytest.raises(KitError, match=r"thickness_mm is 15: the horn of servo wide needs at least 25"):
        tall = replace(SERVOS["ds3225"].horns[0], top_mm=21.0)
        horn_features(
            replace(servo_joint, horn=tall, servo=replace(SERVOS["ds3225"], name="wide")),
            KitSettings(thickness_mm=15.0),
        )
    # Two layers of 100 mm and a gap of 1 mm on either side leave 300 + 100 - 402 mm.
    with pytest.raises(KitError, match=r"pitch_mm is 300: .* leave -2\.0 mm"):
        assemble(crane, KitSettings(thickness_mm=100.0, servo="mg90s"))
    with pytest.raises(DesignError, match="length_scale of link 0 is 5"):
        assemble(with_genes(crane, length_scale=np.array([[5.0, 2, 2, 2, 2, 2]])), SETTINGS)
