"""Findings of the checks, for robots with deliberate faults, and settings that are refused."""

from dataclasses import replace
from itertools import pairwise
from math import pi, radians, sqrt

import numpy as np
import pytest
from shapely import unary_union

from tasks.bench.fabrication import checks
from tasks.bench.fabrication.assembly import Assembly, assemble
from tasks.bench.fabrication.built_bodies import moved
from tasks.bench.fabrication.checks import KitFinding, findings_of
from tasks.bench.fabrication.kit import build_kit
from tasks.bench.fabrication.kit_error import KitError
from tasks.bench.fabrication.kit_settings import KitSettings
from tasks.bench.fabrication.parts import mesh_of, on_bed
from tasks.bench.fabrication.splits import CLEARANCE_MM
from tasks.design import N_LINKS, DesignError, Designs

SETTINGS = KitSettings()
STILL = {"motor_on": np.zeros((1, N_LINKS), dtype=bool)}
WIDE = {"motion_range": np.array([[0, 0.2, radians(61), 0.2, radians(59), 0.2]])}
TWIN = {"parent": np.array([[-1, 0, 0, 2, 0, 4]]), "parent_attachment": np.array([[0, 0, 1, 1, 0.9, 1.0]])}
AT_REST = {"rest_angle": np.array([[0, -pi / 2, -2.2, -pi / 2, 0.8, -pi / 2]])}
# Two equal links joined at their middles, each of which sweeps over all of the other.
FLAT = {
    "parent": np.array([[-1, 0, 0, 0, 0, 0]]),
    "parent_attachment": np.zeros((1, 6)),
    "child_attachment": np.zeros((1, 6)),
    "rest_angle": np.array([[0, 0, 0, 0, 0, pi / 2]]),
    "motor_on": np.array([[False] * 5 + [True]]),
    "motion_range": np.array([[0, 0.2, 0.2, 0.2, 0.2, pi / 2]]),
}


def swinging(phase: float) -> dict[str, np.ndarray]:
    """Clockwise turns bring part 2 down and counter-clockwise ones bring part 3 up, towards one another."""
    return {"motion_range": np.array([[0, 0.2, 1.2, 0.2, 1.2, 0.2]]), "phase": np.array([[0, 0, 0, 0, phase, 0]])}


def with_genes(design: Designs, **genes) -> Designs:
    return replace(design, **{name: np.asarray(value) for name, value in genes.items()})


def findings_that_say(assembly: Assembly, words: str) -> list[KitFinding]:
    return [finding for finding in findings_of(assembly) if words in finding.message]


def test_a_sound_robot_has_no_fault(kit):
    assert not any(finding.severity == "fault" for finding in kit.findings)


@pytest.mark.parametrize(
    ("genes", "settings", "severity", "where", "said"),
    [
        (STILL, {}, "warning", "design", "0 motors are on"),
        (WIDE, {"servo": "hs85mg", "horn": "cross"}, "fault", "joint 2", "swings ±61°"),
        (TWIN, {}, "fault", "part 1, left", "0.00 mm between horn (horn of joint 2) and pin (pin of joint 4)"),
        (FLAT, {}, "fault", "part 1", "no room for a rod"),
        (swinging(0.0), {}, "warning", "part 2 and part 3", "in the range of joint 2 and joint 4 than in the gait"),
        (swinging(pi), {}, "fault", "part 2 and part 3", "in the gait, with"),
        (AT_REST, {}, "fault", "part 2 and part 3", "Change rest_angle"),
        ({}, {"bed_mm": (40.0, 40.0, 20.0)}, "fault", "every part", "25 mm high, but the printer reaches only 20 mm"),
    ],
)
def test_a_finding(crane, genes, settings, severity, where, said):
    robot = assemble(with_genes(crane, **genes), SETTINGS.model_copy(update=settings))
    findings = findings_that_say(robot, said)
    assert where in [finding.where for finding in findings] and {finding.severity for finding in findings} == {severity}
    assert bool(findings_that_say(robot, "No cut across a link")) == ("bed_mm" in settings)


def test_walls_and_necks(crane, kit, monkeypatch):
    # From an ear's screw, 28.3 / 2 from the servo's middle, to the case's opening, 22.8 / 2 + 0.3, less the pilot.
    wall = 28.3 / 2 - 22.8 / 2 - 0.3 - 0.85 * 2.0 / 2
    # Links 2 and 3 overlap in a square of 17.5: its diagonal, and twice what a fillet of radius 5 adds in its corners.
    neck = 17.5 * sqrt(2) + 2 * 5 * (sqrt(2) - 1)
    walled = assemble(crane, SETTINGS.model_copy(update={"servo": "mg90s"}))
    for robot, limit, least, n, said in (
        (walled, "MIN_WALL_MM", wall - 0.01, 0, f"{wall:.2f} mm between case"),
        (walled, "MIN_WALL_MM", wall + 0.01, 2, f"{wall:.2f} mm between case"),
        (kit, "_MIN_NECK_MM", neck - 0.3, 0, "at its narrowest"),
        (kit, "_MIN_NECK_MM", neck + 0.3, 2, "at its narrowest"),
    ):
        monkeypatch.setattr(checks, limit, least)
        assert len(findings_that_say(robot, said)) == n


def test_a_part_larger_than_the_bed_is_split_by_dovetails(crane, kit):
    small = SETTINGS.model_copy(update={"bed_mm": (120.0, 120.0, 200.0)})
    cut = build_kit(crane, small)
    assert not findings_that_say(cut, "the usable bed")
    whole = {part.name: part.solid.volume for part in kit.parts}
    for body, split in enumerate(cut.splits):
        assert split.fits and len(split.pieces) > 1
        gap = unary_union(split.cuts).intersection(cut.profiles[body].polygon)
        for side in ("left", "right"):
            pieces = [p for p in cut.parts if p.body == body and p.side == side]
            assert len(pieces) == len(split.pieces)
            lost = whole[f"part-{body + 1}-{side}"] - sum(p.solid.volume for p in pieces)
            assert lost == pytest.approx(25 * gap.area, rel=1e-4)  # the outline's arcs are chords there
            assert all((on_bed(p, mesh_of(p.solid)).vertices.max(axis=0) <= [110, 110, 26]).all() for p in pieces)
        for a, b in pairwise(split.pieces):
            assert a.distance(b) >= CLEARANCE_MM - 1e-6
        # The dovetail holds: the pieces collide when pulled apart along the link.
        pulled = [np.array([1, 0, 0, 1, dx, dy]) for dx, dy in ((2, 0), (-2, 0), (0, 2), (0, -2))]
        pairs = [(a, b) for a in split.pieces for b in split.pieces if a is not b]
        assert any(moved(a, away).intersects(b) for a, b in pairs for away in pulled)


def test_settings_that_no_part_can_be_made_with(crane):
    # A plate of 29.9 - 18.5 - 2 = 9.4 mm, ears of 2 mm and a notch of 5 mm for the cable. A horn that ends 15 mm above
    # the case lies 14 mm deep, under which 5 mm must remain. Two layers of 100 mm and a gap of 1 mm on either side
    # leave 300 + 100 - 402 mm.
    for settings, said in (
        ({"thickness_mm": 15.0, "servo": "hs85mg"}, r"thickness_mm is 15: servo hs85mg needs at least 16\.4"),
        ({"thickness_mm": 18.0, "measured": {"top_mm": 15.0}}, r"is 18: the horn of servo ds3225 needs at least 19"),
        ({"thickness_mm": 100.0, "servo": "mg90s"}, r"pitch_mm is 300: .* leave -2\.0 mm"),
    ):
        with pytest.raises(KitError, match=said):
            assemble(crane, KitSettings(**settings))
    with pytest.raises(DesignError, match="length_scale of link 0 is 5"):
        assemble(with_genes(crane, length_scale=np.array([[5.0, 2, 2, 2, 2, 2]])), SETTINGS)
