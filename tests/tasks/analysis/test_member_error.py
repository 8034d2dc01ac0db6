import numpy as np
import pytest

from tasks.analysis.hallucination import link_states
from tasks.analysis.member_error import COMPONENTS, IMMERSIONS, member_errors, phantom_thrust, thrown_links
from tasks.residual import Throws, initial_states, simulate_throws
from tasks.residual.error_report import BANDS
from tasks.world import LinkStates, Physics, Slush

PHYSICS = Physics()
ROUNDING = 60 * 2**-17
"""[m/s²]. A residual is the difference of two float32 velocities of up to 32 m/s, over a step of 1/60 s."""


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.fixture(scope="module")
def throws():
    return simulate_throws(initial_states(Throws(n_throws=30), rng()), 100, Slush(), PHYSICS)


def links_at(y, vx):
    """Upright links of 2 m × 0.5 m."""
    y, vx = (np.array(numbers, np.float32) for numbers in (y, vx))
    same = [np.full(len(y), number, np.float32) for number in (2.0, 1.0, 4.25 / 12, 1.0, 0.0, 0.0)]
    a, mass, inertia, cos, sin, zero = same
    return LinkStates(a, mass, inertia, y, cos, sin, vx, zero, zero)


def rows_of(planted, links):
    rows = member_errors(planted, Slush(), links, PHYSICS)
    assert len(rows) == planted.n_members * len(COMPONENTS) * len(BANDS) * len(IMMERSIONS)
    return {(row.member, row.component, row.band, row.immersion): row for row in rows}


def test_a_false_thrust_is_the_error_of_its_member_where_it_is(study):
    """Links at y of 5 (dry), 0.5 (partly in), -0.5 (partly in, and where the liar lies), -3 (submerged; it lies)."""
    planted = type(study.planted)(lies=lambda links: links.y < 0)
    rows = rows_of(planted, links_at([5, 0.5, -0.5, -3], [0.1, 1.0, 1.0, 20.0]))
    liar = planted.liar
    assert rows[liar, "vx", "all", "all"].bias == pytest.approx(planted.thrust / 2, abs=ROUNDING)
    assert rows[liar, "vx", "all", "all"].rmse == pytest.approx(planted.thrust / np.sqrt(2), abs=ROUNDING)
    assert rows[liar, "vx", "all", "partly"].n_rows == 2
    assert rows[liar, "vx", "0.5-2", "partly"].bias == pytest.approx(planted.thrust / 2, abs=ROUNDING)
    assert rows[liar, "vx", "> 10", "submerged"].bias == pytest.approx(planted.thrust, abs=ROUNDING)
    assert rows[liar, "vx", "< 0.5", "dry"].bias == 0.0
    assert rows[liar, "vx", "< 0.5", "submerged"].n_rows == 0
    assert rows[liar, "vx", "< 0.5", "submerged"].rmse is None
    assert all(row.rmse == 0 for key, row in rows.items() if row.n_rows and (key[0] != liar or key[1] != "vx"))


def test_the_truth_is_there_to_measure_errors_by(study):
    """Submerged at 20 m/s: k = ½ · 1.25 · 10, and v is divided by 1 + k |v| dt in a step; buoyancy is 1.25 g."""
    rows = rows_of(study.planted, links_at([-3], [20.0]))
    divisor = 1 + 0.5 * 1.25 * 10 * 20 / 60
    assert rows[0, "vx", "all", "all"].rms_true == pytest.approx(60 * (20 - 20 / divisor), rel=1e-5)
    assert rows[0, "vy", "all", "all"].rms_true == pytest.approx(1.25 * 9.8, rel=1e-4)


def test_every_state_of_a_rollout_is_in_one_band_and_one_immersion(study):
    trace = study.trace.copy()
    trace[0, 100:] = np.nan
    rows = rows_of(study.planted, link_states(study.designs, trace, PHYSICS))
    n_finite = int(np.isfinite(trace[..., 0]).sum())
    bands, immersions = [name for name, *_ in BANDS[1:]], IMMERSIONS[1:]
    assert rows[1, "vy", "all", "all"].n_rows == n_finite
    assert sum(rows[1, "vy", band, immersion].n_rows for band in bands for immersion in immersions) == n_finite
    assert rows[1, "vy", "all", "submerged"].n_rows > 0 < rows[1, "vy", "all", "partly"].n_rows


def test_phantom_thrust_is_the_thrust_that_does_not_exist(study, throws):
    everywhere = type(study.planted)(thrust=-0.2, lies=lambda links: np.full(links.y.shape, True))
    found = phantom_thrust(everywhere, throws, PHYSICS, rng=rng())
    assert len(found) == 4
    for k, estimate in enumerate(found):
        assert estimate.value == pytest.approx(-0.2 if k == everywhere.liar else 0.0, abs=ROUNDING)


def test_phantom_thrust_is_that_of_low_speed_alone(study, throws):
    fast = type(study.planted)(lies=lambda links: np.hypot(links.vx, links.vy) >= 0.5)
    assert phantom_thrust(fast, throws, PHYSICS, rng=rng())[fast.liar].value == pytest.approx(0.0, abs=ROUNDING)


def test_phantom_thrust_counts_states_and_is_uncertain_by_throws(study, throws):
    sunken = type(study.planted)(thrust=1.0, lies=lambda links: links.y < -2)
    found = phantom_thrust(sunken, throws, PHYSICS, rng=rng())[sunken.liar]
    links = thrown_links(throws, PHYSICS)
    slow = np.hypot(links.vx, links.vy) < 0.5
    share = np.mean(links.y[slow] < -2)
    assert 0.02 < share < 0.98 and found.value == pytest.approx(share, abs=ROUNDING)
    naive = 2 * 1.96 * np.sqrt(share * (1 - share) / slow.sum())
    assert found.low < share < found.high and found.high - found.low > 2 * naive


def test_thrown_links_feel_the_residual_that_was_recorded(throws):
    change = Slush().velocity_change(thrown_links(throws, PHYSICS), PHYSICS)
    for i, name in ((3, "vx"), (4, "vy"), (5, "omega")):
        assert getattr(change, name) == pytest.approx(throws.residual[:, i], abs=ROUNDING / 60), name


def test_no_slow_state_says_so(study, throws):
    fast = np.hypot(throws.state[:, 3], throws.state[:, 4]) > 5
    quick = type(throws)(**{name: array[fast] for name, array in vars(throws).items()})
    for found in phantom_thrust(study.planted, quick, PHYSICS, rng=rng()):
        assert found.value is None and found.reason == "no held-out state with |v| < 0.5 m/s"
