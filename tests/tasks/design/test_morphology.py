"""Links apart: the separating axes against a polygon clipper, what merely touches, and draws that find nothing."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.design import DesignError, Designs, Morphology, links_apart, random_designs, rest_pose
from tasks.design.morphology import MAX_BATCH, N_INSTANTS, apart_in_gait, sample_allowed

APART = Morphology(unjoined_links="apart")


def clipped_overlap(designs: Designs, design: int) -> float:
    """Largest area that two links share that no joint ties [m²]."""
    boxes, parent = [], designs.parent[design]
    for a, x, y, angle in zip(designs.length_scale[design], *(of[design] for of in rest_pose(designs)), strict=True):
        c, s = np.cos(angle), np.sin(angle)
        box = shapely.box(-0.5 / a, -a / 2, 0.5 / a, a / 2)
        boxes.append(shapely.affinity.affine_transform(box, [c, -s, s, c, x, y]))
    return max(boxes[i].intersection(boxes[j]).area for j in range(6) for i in range(j) if parent[j] != i)


def chains(designs: Designs, straighter: float) -> Designs:
    """Chains that bend less, of which some are apart and some are not."""
    ends = np.ones(designs.parent.shape)
    return replace(
        designs,
        parent=np.tile(np.arange(-1, 5), (len(designs), 1)),
        parent_attachment=ends,
        child_attachment=-ends,
        rest_angle=designs.rest_angle / straighter,
    )


@settings(max_examples=30)
@given(st.integers(0, 2**63 - 1))
def test_links_are_apart_where_a_polygon_clipper_finds_no_common_area(seed: int) -> None:
    designs = random_designs(8, np.random.default_rng(seed))
    for some in (designs, chains(designs, 4)):  # so that both answers are asked for
        for design, apart in enumerate(links_apart(some)):
            overlap = clipped_overlap(some, design)
            assert apart == (overlap == 0) or overlap < 1e-12  # of a hair's breadth both may be said


@settings(max_examples=10)
@given(st.integers(0, 2**63 - 1))
def test_gaits_are_apart_where_a_polygon_clipper_finds_no_common_area_at_any_instant(seed: int) -> None:
    designs = chains(random_designs(12, np.random.default_rng(seed)), 3)
    period = np.arange(N_INSTANTS) / N_INSTANTS
    for design, apart in enumerate(apart_in_gait(designs)):
        of = designs[[design] * N_INSTANTS]
        phase = 2 * np.pi * period[:, None] + of.phase
        moved = replace(of, rest_angle=of.rest_angle + of.motor_on * of.motion_range * np.sin(phase))
        overlap = max(clipped_overlap(moved, instant) for instant in range(N_INSTANTS))
        assert apart == (overlap == 0) or overlap < 1e-12


def test_draws_end() -> None:
    some = random_designs(2000, np.random.default_rng(3))
    bad, good = some[~links_apart(some)][0], some[links_apart(some)][0]
    n_asked = 0

    def draw(which: np.ndarray) -> np.ndarray:
        nonlocal n_asked
        n_asked += len(which)
        assert len(which) <= MAX_BATCH
        return bad.table[np.zeros(len(which), int)]

    with pytest.raises(DesignError, match=r"design 0: 1,000 samples were drawn and none .* by unjoined_links=apart"):
        sample_allowed(draw(np.arange(2)), draw, APART, max_draws=1000)
    assert n_asked == 2000
    instead = sample_allowed(draw(np.arange(2)), draw, APART, max_draws=1000, otherwise=good.table[[0, 0]])
    assert links_apart(instead.designs).all()
    assert instead.n_draws.tolist() == [1001, 1001]


def test_no_motor_swings_faster_than_is_allowed() -> None:
    designs = random_designs(20, np.random.default_rng(1))
    speed = 2 * np.pi * designs.frequency[:, None] * designs.motion_range
    allowed = Morphology(max_joint_speed=1.0).allows(designs)
    np.testing.assert_array_equal(allowed, ~(designs.motor_on & (speed > 1.0)).any(axis=1))
    assert 0 < allowed.sum() < 20
