"""Tables of tracks: what they are in the simulation, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from tank import SCALE, filmed

from tasks.bench.tracks import TrackError, Tracks, TrackTable
from tasks.bench.tracks.table import paths_of
from tasks.world import froude_time

PLAIN = Tracks(file="tracks.csv")


@pytest.fixture(scope="module")
def table() -> TrackTable:
    return filmed(4)[0]


def changed(table: TrackTable, name: str, row: int, value: float) -> TrackTable:
    column = getattr(table, name).copy()
    column[row] = value
    return replace(table, **{name: column})


def only(table: TrackTable, rows) -> TrackTable:
    return TrackTable(*(getattr(table, name)[rows] for name in ("throw", "time", "x", "y", "angle")))


def test_froude_scales_lengths_and_times(table: TrackTable) -> None:
    paths = paths_of(table, PLAIN)
    np.testing.assert_allclose(paths.pose[0, :, 0], table.x[table.throw == 0] / SCALE)
    np.testing.assert_allclose(paths.time[0], table.time[table.throw == 0] / froude_time(SCALE))
    unscaled = paths_of(table, Tracks(file="tracks.csv", metres_per_metre=1.0))
    np.testing.assert_allclose(unscaled.pose[0, :, 0], table.x[table.throw == 0])
    np.testing.assert_allclose(unscaled.time[0], table.time[table.throw == 0])


def test_units_axes_and_wrapped_angles_change_nothing_once_they_are_stated(table: TrackTable) -> None:
    wrapped = np.degrees(np.remainder(table.angle + np.pi, 2 * np.pi) - np.pi)
    other = replace(table, x=-1000 * table.x, y=-1000 * table.y, angle=-wrapped)
    sd = np.full(len(table.x), 2.0)
    other = replace(other, x_sd=sd, y_sd=sd, angle_sd=sd)
    stated = Tracks(file="tracks.csv", length_unit="mm", angle_unit="deg", flip_x=True, flip_y=True, flip_angle=True)
    converted, plain = paths_of(other, stated), paths_of(table, PLAIN)
    np.testing.assert_allclose(converted.pose[..., :2], plain.pose[..., :2])
    np.testing.assert_allclose(converted.sd[0, 0], [0.002 / SCALE, 0.002 / SCALE, np.radians(2.0)])
    whole_turns = (converted.pose - plain.pose)[..., 2] / (2 * np.pi)
    np.testing.assert_allclose(whole_turns, np.round(whole_turns[:, :1]) + np.zeros_like(whole_turns), atol=1e-9)


def test_gaps_uneven_frames_and_throws_of_different_lengths(table: TrackTable) -> None:
    chosen = np.sort(np.random.default_rng(1).permutation(len(table.throw))[:40])
    paths = paths_of(only(table, chosen), PLAIN)
    for k, number in enumerate(paths.throw):
        rows = chosen[table.throw[chosen] == number]
        seen = paths.seen[k]
        assert seen.sum() == len(rows)
        np.testing.assert_allclose(paths.pose[k, seen, 1], table.y[rows] / SCALE)
        assert (paths.pose[k, ~seen] == paths.pose[k, seen][-1]).all()


def test_rows_of_throws_may_alternate(table: TrackTable) -> None:
    order = np.argsort(table.time, kind="stable")
    np.testing.assert_array_equal(paths_of(only(table, order), PLAIN).pose, paths_of(table, PLAIN).pose)


def test_throws_may_have_names_and_numbers_below_zero(table: TrackTable) -> None:
    paths = paths_of(replace(table, throw=np.array(["d", "c", "b", "a"])[table.throw]), PLAIN)
    assert paths.throw.tolist() == ["a", "b", "c", "d"] and paths.number.tolist() == [0, 1, 2, 3]
    assert paths_of(replace(table, throw=table.throw - 1), PLAIN).number.tolist() == [0, 1, 2, 3]
    assert paths_of(replace(table, throw=table.throw + 5), PLAIN).number.tolist() == [5, 6, 7, 8]
    with pytest.raises(TrackError, match="throw b, frame 3: x is nan"):
        wrong = one_frame("x", np.nan)(table)
        paths_of(replace(wrong, throw=np.array(["a", "b", "c", "d"])[table.throw]), PLAIN)


def frame(table: TrackTable, throw: int, number: int) -> int:
    return int(np.flatnonzero(table.throw == throw)[number])


def one_frame(name: str, value: float):
    return lambda table: changed(table, name, frame(table, 1, 3), value)


def moved_frame(name: str, by: float):
    return lambda table: changed(table, name, row := frame(table, 2, 6), getattr(table, name)[row] + by)


def turned(table: TrackTable, per_frame: float, factor: float = 1.0) -> TrackTable:
    turn = np.remainder(0.5 + per_frame * np.arange(len(table.time) // 4), 2 * np.pi)
    return replace(table, angle=factor * np.tile(turn, 4))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (one_frame("x", np.nan), "throw 1, frame 3: x is nan, expected a number: leave out frames"),
        (one_frame("angle", np.inf), "throw 1, frame 3: angle is inf"),
        (one_frame("time", 0.0), "throw 1, frame 3: the time is 0 s after 0.0333333 s, expected a later one"),
        (one_frame("x", 9.0), "throw 1, frame 3: the bar jumps at .* expected at most 15.9 m/s: remove frames"),
        (moved_frame("x", 0.03), r"throw 2, frame 6: the bar jumps by 0\.\d+ m and back: remove frames"),
        # 15 cm between two frames are 9 m/s, no more than the fastest throw of the paper.
        (moved_frame("x", 0.15), r"throw 2, frame 6: the bar jumps by 0\.\d+ m and back: remove frames"),
        (moved_frame("angle", 1.4), r"throw 2, frame 6: the bar turns by \d\d\.?\d?° and back: remove frames"),
        (lambda table: turned(table, 2.8), r"throw 0, frame 1: the bar turns by 2\.8 rad since the frame before"),
        (lambda table: turned(table, 0.02, 180 / np.pi), r"50% of the angles are at most [\d.]+ rad, expected at most"),
        (lambda table: replace(table, time=1000 * table.time), r"throw 0 lasts for [\d.]+ s, expected at most 120 s"),
        (lambda table: only(table, table.throw == 0), "1 throws, expected at least 2"),
        (lambda table: only(table, np.arange(frame(table, 1, 0) + 1)), "1 has 1 fra"),
        (lambda table: replace(table, x=1e3 * table.x, y=1e3 * table.y), r"jumps at .* check tracks.length_unit"),
    ],
)
def test_what_is_refused(table: TrackTable, change, message: str) -> None:
    with pytest.raises(TrackError, match=message):
        paths_of(change(table), PLAIN)


def test_a_bar_may_turn_back_at_a_contact_and_by_less_than_a_video_shows() -> None:
    """A precise track of a bar that falls, hits the floor at frame 20 and rises, turning by 20° and back there."""
    time = np.arange(40) / 150
    away = np.abs(time - time[20])
    angle = 0.1 * time + np.radians(20) * (np.arange(40) == 20)
    tracks = TrackTable(np.repeat([0, 1], 40), *(np.tile(of, 2) for of in (time, 0.1 * time, away, angle)))
    paths_of(tracks, PLAIN)
    with pytest.raises(TrackError, match=r"throw 0, frame 20: the bar turns by 20\.?\d*° and back"):
        paths_of(replace(tracks, y=np.tile(-time, 2)), PLAIN)
    paths_of(replace(tracks, y=np.tile(-time, 2), angle=np.tile(0.1 * time + 0.02 * (np.arange(40) == 20), 2)), PLAIN)


def test_degrees_are_told_from_radians(table: TrackTable) -> None:
    degrees = Tracks(file="tracks.csv", angle_unit="deg")
    with pytest.raises(TrackError, match=r"90% of the angles are at most \d\.\d+ deg, expected more than 6\.28: check"):
        paths_of(turned(table, 0.02), degrees)  # 28° and more, by a degree a frame
    paths_of(turned(table, 0.02, 180 / np.pi), degrees)


def test_a_bar_that_bounces_jumps_nowhere(table: TrackTable) -> None:
    """It leaves the wall as fast as it reached it."""
    rows = np.flatnonzero(table.throw == 1)
    at = table.time[rows] - table.time[rows[0]]
    x = table.x.copy()
    x[rows] = np.abs(at - at[len(at) // 2])  # m at 1 m/s
    paths_of(replace(table, x=x), PLAIN)
