"""Residuals of tracked throws against the medium's own, with and without noise."""

from dataclasses import replace

import numpy as np
import pytest
from tank import SCALE, filmed

from tasks.bench.tracks import Bars, TrackError, Tracks, TrackTable, residual_transitions
from tasks.bench.tracks.residuals import TrackReport, check_throws, smooth_throws
from tasks.residual import MeasuredTransitions
from tasks.simulation.free_links import FreeLinks
from tasks.world import Physics, Slush

pytestmark = pytest.mark.slow

PLAIN = Tracks(file="tracks.csv")
PHYSICS = Physics()


def smoothed(table: TrackTable, bars: Bars, tracks: Tracks = PLAIN) -> tuple[MeasuredTransitions, TrackReport]:
    throws = smooth_throws(table, bars, tracks, PHYSICS)
    return throws.transitions, throws.report


def errors(transitions, *, slower_than: float) -> np.ndarray:
    """Return the errors of residuals as shares of their size, where bars are slow."""
    links = FreeLinks(transitions.length_scale, PHYSICS)
    true = (links.step(transitions.state, Slush()) - links.step(transitions.state, None))[:, 3:]
    slow = (np.hypot(*transitions.state[:, 3:5].T) < slower_than) & (np.abs(transitions.state[:, 5]) < slower_than)
    error = transitions.residual[slow, 3:] - true[slow]
    return np.sqrt(np.mean(error**2, axis=0) / np.mean(true[slow] ** 2, axis=0))


def test_slow_bars_show_the_mediums_residual() -> None:
    transitions, report = smoothed(*filmed(8, rate=240.0, seconds=0.5))
    assert (errors(transitions, slower_than=2.0) < (0.2, 0.1, 0.25)).all()
    assert report.n_contacts == 0 and report.n_gaps == 0 and not report.sd_given
    assert report.fall.acceleration == pytest.approx(-9.8, abs=0.1)


def test_rollouts_find_spins_that_die_out_between_frames() -> None:
    """Fast bars lose most of their spin in the 3.8 steps between two frames, which a smoother takes for less drag."""
    thrown = filmed(12)
    of_poses, _ = smoothed(*thrown)
    transitions, _ = residual_transitions(*thrown, PLAIN, PHYSICS, n_iterations=100)
    tracked = transitions[transitions.throw >= 0]
    assert (errors(tracked, slower_than=20.0) < (0.15, 0.1, 0.15)).all()
    assert errors(of_poses, slower_than=20.0)[2] > 0.4
    assert np.abs(tracked.state[:, 5]).max() <= np.abs(of_poses.state[:, 5]).max()


def test_throws_in_the_fitted_medium_cover_what_was_not_thrown_with_their_uncertainty() -> None:
    thrown = filmed(12, noise_mm=0.3, noise_deg=0.3)
    transitions, _ = residual_transitions(*thrown, PLAIN, PHYSICS, n_iterations=60)
    tracked, further = transitions[transitions.throw >= 0], transitions[transitions.throw < 0]
    links = FreeLinks(further.length_scale, PHYSICS)
    error = further.next_in_target - links.step(further.state, Slush())
    share = np.sqrt(np.mean(error[:, 3:] ** 2, axis=0) / np.mean(further.residual[:, 3:] ** 2, axis=0))
    assert (share < 0.3).all()
    assert len(np.unique(further.throw)) > 200 and np.ptp(further.state[:, 1]) > np.ptp(tracked.state[:, 1])
    dry = further.state[:, 1] > 2.0  # higher than half a bar
    assert dry.any() and (further.next_in_target[dry] == further.next_on_dry_land[dry]).all()
    stated = further.residual_sd[:, 3:]
    assert (stated == stated[0]).all() and (stated[0] < 0.2 * further.residual[:, 3:].std(axis=0)).all()


def test_rows_are_those_of_the_base_simulator() -> None:
    transitions, _ = smoothed(*filmed(4, seconds=0.5))
    dry = FreeLinks(transitions.length_scale, PHYSICS).step(transitions.state, None)
    np.testing.assert_array_equal(transitions.next_on_dry_land, dry)
    np.testing.assert_array_equal(transitions.residual, transitions.next_in_target - transitions.next_on_dry_land)
    step = np.float32(PHYSICS.time_step)
    moved = transitions.next_in_target[:, :3] - transitions.state[:, :3]
    np.testing.assert_allclose(moved, step * transitions.next_in_target[:, 3:], atol=1e-5)


def test_noise_is_reported_and_widens_the_uncertainty() -> None:
    sharp, _ = smoothed(*filmed(12, seconds=0.6))
    transitions, report = smoothed(*filmed(12, seconds=0.6, noise_mm=0.5, noise_deg=0.5))
    assert np.array(report.noise) == pytest.approx([0.0005 / SCALE, 0.0005 / SCALE, np.radians(0.5)], rel=0.35)
    assert (np.median(transitions.residual_sd[:, 3:], axis=0) > 1.5 * np.median(sharp.residual_sd[:, 3:], axis=0)).all()


def test_steps_in_a_gap_are_left_out() -> None:
    table, bars = filmed(4, seconds=1.0)
    of_one = np.flatnonzero(table.throw == 1)
    left = np.setdiff1d(np.arange(len(table.throw)), of_one[5:11])
    shorter = type(table)(*(getattr(table, name)[left] for name in ("throw", "time", "x", "y", "angle")))
    transitions, report = smoothed(shorter, bars)
    assert report.n_gaps == 1
    assert report.n_rows_in_gaps == pytest.approx(7 / 60 / SCALE**0.5 * 60, abs=2)
    steps = transitions.step[transitions.throw == 1]
    assert np.diff(steps).max() == report.n_rows_in_gaps + 1


def test_rows_at_contacts_are_left_out_and_counted() -> None:
    """Bars that fly level at 2 m/s through air, and one of them against a wall at x = 0.5 m."""
    time = np.linspace(0, 1, 17)
    x = np.stack([2 * time, 2 * time, 0.5 - np.abs(0.5 - 2 * time), 2 * time])
    throw = np.repeat(np.arange(4), 17)
    table = TrackTable(throw, np.tile(time, 4), x.ravel(), np.tile(9 - 4.9 * time**2, 4), np.zeros(4 * 17))
    bars = Bars(np.arange(4), np.ones(4), np.ones(4), np.ones(4))
    transitions, report = smoothed(table, bars, Tracks(file="tracks.csv", metres_per_metre=1.0))
    assert report.n_contacts == 1
    # Steps of 1/60 s that touch the three frames on each side of the contact: 6 intervals of 1/16 s, and both ends.
    assert report.n_rows_at_contacts == pytest.approx(6 / 16 * 60, abs=2)
    assert len(transitions) == 4 * 60 - report.n_rows_at_contacts
    left_out = ~np.isin(transitions.step, transitions.step[transitions.throw == 2])
    assert set(transitions.throw[left_out]) == {0, 1, 3}


def test_tracks_that_are_refused() -> None:
    table, bars = filmed(12, seconds=0.6)
    with pytest.raises(TrackError, match=r"no bar's centre is ever below the waterline.*lowest: 0\.01 m"):
        check_throws(replace(table, y=table.y - table.y.min() + 0.01), bars, PLAIN, PHYSICS)
    fewer = type(bars)(*(getattr(bars, name)[:3] for name in ("throw", "length", "width", "mass")))
    for of, with_bars, said in (
        (table, fewer, "throw 3 has no bar"),
        (replace(table, y=-table.y), bars, r"fall freely upward.*check tracks\.flip_y"),
    ):
        with pytest.raises(TrackError, match=said):
            smoothed(of, with_bars)
