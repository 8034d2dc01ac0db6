"""Falls in air that are wrong, and a waterline that is."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from tank import filmed

from tasks.bench.tracks import Tracks
from tasks.bench.tracks.free_fall import check_falls
from tasks.bench.tracks.residuals import smooth_throws
from tasks.bench.tracks.table import TrackError
from tasks.residual import MeasuredTransitions, Throws, initial_states, simulate_throws
from tasks.world import Physics, Slush

ROBOTS = {"y_reach": 2.0, "max_velocity": 4.0, "max_omega": 3.0}  # their states, about
PHYSICS = Physics()


def refused(is_wrong: bool, message: str):
    return pytest.raises(TrackError, match=message) if is_wrong else nullcontext()


def measured(columns: dict[str, np.ndarray]) -> MeasuredTransitions:
    sd, never = np.full_like(columns["residual"], 1e-3), np.zeros(len(columns["throw"]), dtype=bool)
    return MeasuredTransitions(**columns, residual_sd=sd, held_out=never)


@pytest.mark.parametrize("factor", [0.5, 1.2, 2.0])
def test_bars_that_fall_too_fast_or_too_slowly_are_refused(factor: float) -> None:
    """Throws through air, of a tank whose scale is off by a factor; by a fifth is a warning."""
    throws = initial_states(Throws(n_throws=20, **ROBOTS), np.random.default_rng(2))
    state = throws.state.copy()
    state[:, 1] += 30
    exact = simulate_throws(replace(throws, state=state), 30, Slush(), PHYSICS)
    plain = measured(exact.columns())
    gravity = PHYSICS.gravity * factor  # of the simulator; bars fall as ever
    residual = plain.residual.copy()
    residual[:, 4] += (gravity - PHYSICS.gravity) * PHYSICS.time_step
    fallen = replace(plain, residual=residual)
    with refused(factor != 1.2, r"bars above the water fall at 9\.8 ± .* expected"):
        fall = check_falls(fallen, fallen.throw, gravity, PHYSICS.time_step)
        assert fall.acceleration == pytest.approx(-9.8, abs=0.01)


@pytest.mark.parametrize("rise", [-1.0, -0.5, 0.0, 0.5, 1.5, 3.0])
def test_a_waterline_that_is_wrong_by_a_bars_length_is_refused(rise: float) -> None:
    """Bars of throws as they are, whose heights are counted from a waterline that is off [m of simulation]."""
    throws = initial_states(Throws(n_throws=60, **ROBOTS), np.random.default_rng(2))
    exact = simulate_throws(throws, 60, Slush(), PHYSICS)
    state = exact.state.copy()
    state[:, 1] -= rise
    columns = {**exact.columns(), "state": state}
    moved = measured(columns)
    with refused(abs(rise) >= 1, r"check that y is 0 at the waterline"):
        check_falls(moved, moved.throw, PHYSICS.gravity, PHYSICS.time_step)


@pytest.mark.parametrize(("slow", "within"), [(1.0, True), (2.0, True), (2.0, False), (4.0, False)])
def test_a_speed_ramp_within_a_file_is_refused(slow: float, within: bool) -> None:
    """Bars that fall through air; the end of each throw, or a third of the throws, is slowed down as phones do it."""
    table, bars = filmed(12, rate=240.0, seconds=0.6, noise_mm=0.2, medium=Slush(density=0.0))
    table = replace(table, y=table.y + 0.3)
    start = table.time[0]
    stretched = table.time.copy()
    if within:
        late = np.maximum(table.time - start - 0.05, 0)
        stretched += (slow - 1) * late
    else:
        stretched[table.throw % 3 == 0] *= slow
    with refused(slow > 1, r"throw \d+.*one speed of the video throughout|slow motion is tracked with"):
        smooth_throws(replace(table, time=stretched), bars, Tracks(file="tracks.csv"), PHYSICS)
