"""Tables of tracks: what they are in the simulation, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from tank import SCALE, filmed

from tasks.tracks import TrackError, Tracks, TrackTable
from tasks.tracks.table import paths_of
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
    unscaled = paths_of(table, Tracks(file="tracks.csv", scaling="none"))
    np.testing.assert_allclose(unscaled.pose[0, :, 0], table.x[table.throw == 0])
    np.testing.assert_allclose(unscaled.time[0], table.time[table.throw == 0])


def test_units_axes_and_wrapped_angles_change_nothing_once_they_are_stated(table: TrackTable) -> None:
    wrapped = np.degrees(np.remainder(table.angle + np.pi, 2 * np.pi) - np.pi)
    other = replace(table, x=-1000 * table.x, y=-1000 * table.y, angle=-wrapped)
    stated = Tracks(file="tracks.csv", length_unit="mm", angle_unit="deg", flip_x=True, flip_y=True, flip_angle=True)
    found, plain = paths_of(other, stated), paths_of(table, PLAIN)
    np.testing.assert_allclose(found.pose[..., :2], plain.pose[..., :2])
    whole_turns = (found.pose - plain.pose)[..., 2] / (2 * np.pi)
    np.testing.assert_allclose(whole_turns, np.round(whole_turns[:, :1]) + np.zeros_like(whole_turns), atol=1e-9)


def test_gaps_uneven_frames_and_throws_of_different_lengths(table: TrackTable) -> None:
    rng = np.random.default_rng(1)
    chosen = np.sort(rng.permutation(len(table.throw))[:40])
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


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("x", np.nan, "throw 1, frame 3: x is nan, expected a number: leave out frames"),
        ("angle", np.inf, "throw 1, frame 3: angle is inf"),
        ("time", 0.0, "throw 1, frame 3: the time is 0 s after 0.0333333 s, expected a later one"),
        ("x", 9.0, "throw 1, frame 3: the bar jumps at .* expected at most 15.9 m/s: remove frames"),
    ],
)
def test_a_bad_frame_is_named(table: TrackTable, name: str, value: float, message: str) -> None:
    row = int(np.flatnonzero(table.throw == 1)[3])
    with pytest.raises(TrackError, match=message):
        paths_of(changed(table, name, row, value), PLAIN)


def test_a_turn_that_might_have_been_the_other_way_is_refused(table: TrackTable) -> None:
    spinning = replace(table, angle=np.tile(np.arange(len(table.time) // 4) * 2.8, 4))
    with pytest.raises(TrackError, match=r"throw 0, frame 1: the bar turns by 2\.8 rad since the frame before"):
        paths_of(spinning, PLAIN)


@pytest.mark.parametrize("away", [0.03, 0.15])
def test_a_frame_in_which_the_bar_is_elsewhere_is_named(table: TrackTable, away: float) -> None:
    """15 cm between two frames are 9 m/s, no more than the fastest throw of the paper."""
    row = np.flatnonzero(table.throw == 2)[6]
    with pytest.raises(TrackError, match=r"throw 2, frame 6: the bar jumps by 0\.\d+ m and back: remove frames"):
        paths_of(changed(table, "x", row, table.x[row] + away), PLAIN)


def test_a_frame_from_which_the_bar_is_elsewhere_is_named(table: TrackTable) -> None:
    """Another bar was taken for it: 3 cm between two frames are no faster than a throw."""
    rows = np.flatnonzero(table.throw == 2)[6:]
    x = table.x.copy()
    x[rows] += 0.03
    with pytest.raises(
        TrackError, match=r"throw 2, frame 6: the bar jumps by 0\.0\d+ m since the frame before, and go"
    ):
        paths_of(replace(table, x=x), PLAIN)


def test_a_frame_in_which_the_bar_has_turned_is_named(table: TrackTable) -> None:
    row = np.flatnonzero(table.throw == 1)[5]
    with pytest.raises(TrackError, match=r"throw 1, frame 5: the bar turns by \d\d\.?\d?° and back: remove frames"):
        paths_of(changed(table, "angle", row, table.angle[row] + np.radians(80)), PLAIN)


@pytest.mark.parametrize("factor", [8, 1 / 8])
def test_a_throw_in_slow_motion_among_others_is_refused(table: TrackTable, factor: float) -> None:
    time = np.where(table.throw == 3, table.time * factor, table.time)
    with pytest.raises(TrackError, match=r"throw 3 has [\d.]+ frames a second, most throws 60: .* with --slowdown"):
        paths_of(replace(table, time=time), PLAIN)


def test_times_in_milliseconds_are_refused(table: TrackTable) -> None:
    with pytest.raises(TrackError, match=r"throw 0 lasts for [\d.]+ s, expected at most 120 s: give times in seconds"):
        paths_of(replace(table, time=1000 * table.time), PLAIN)


def test_a_bar_that_bounces_jumps_nowhere(table: TrackTable) -> None:
    """It leaves the wall as fast as it reached it."""
    rows = np.flatnonzero(table.throw == 1)
    at = table.time[rows] - table.time[rows[0]]
    x = table.x.copy()
    x[rows] = np.abs(at - at[len(at) // 2])  # m at 1 m/s
    paths_of(replace(table, x=x), PLAIN)


def test_one_frame_and_one_throw_are_too_few(table: TrackTable) -> None:
    rows = np.concatenate([np.flatnonzero(table.throw == 0), np.flatnonzero(table.throw == 1)[:1]])
    with pytest.raises(TrackError, match="throw 1 has 1 frame, expected at least 4: leave the throw out"):
        paths_of(only(table, rows), PLAIN)
    with pytest.raises(TrackError, match="1 throws, expected at least 2"):
        paths_of(only(table, table.throw == 0), PLAIN)


@pytest.mark.parametrize("unit", [1e-6, 1e4])
def test_positions_in_another_unit_are_refused(table: TrackTable, unit: float) -> None:
    slow = replace(table, x=table.x * unit, y=table.y * unit)
    with pytest.raises(TrackError, match=r"the throws move by .* check tracks.length_unit \(m or mm\) and tracks.scal"):
        paths_of(slow, PLAIN)


def test_one_throw_in_another_unit_is_refused(table: TrackTable) -> None:
    """It is in metres, among others in millimetres."""
    other = table.throw == 2
    mixed = replace(table, **{name: getattr(table, name) * np.where(other, 1, 1000) for name in ("x", "y")})
    with pytest.raises(
        TrackError, match=r"throw 2 moves by 0\.\d+ mm, the others by [\d.]+ mm \(median\): give all throws"
    ):
        paths_of(mixed, Tracks(file="tracks.csv", length_unit="mm"))


@pytest.mark.parametrize(
    ("said", "factor", "message"),
    [
        ("deg", 1.0, r"nine in ten angles are at most \d\.\d+°.* check tracks\.angle_unit"),
        ("rad", 180 / np.pi, r"throw 0: angles are [\d.]+ rad \(median\), expected at most 12\.6: check tracks\.an"),
    ],
)
def test_angles_in_another_unit_are_refused(table: TrackTable, said: str, factor: float, message: str) -> None:
    turns = np.tile(0.5 + 0.02 * np.arange(len(table.time) // 4), 4)  # 28° and more, by a degree a frame
    with pytest.raises(TrackError, match=message):
        paths_of(replace(table, angle=turns * factor), Tracks(file="tracks.csv", angle_unit=said))
    stated = Tracks(file="tracks.csv", angle_unit="deg" if said == "rad" else "rad")
    paths_of(replace(table, angle=turns * factor), stated)


def test_one_throw_in_degrees_among_radians_is_refused(table: TrackTable) -> None:
    turns = np.tile(0.5 + 0.02 * np.arange(len(table.time) // 4), 4)
    angle = np.where(table.throw == 2, np.degrees(turns), turns)
    with pytest.raises(TrackError, match=r"throw 2: angles are [\d.]+ rad \(median\).* give all throws in one unit"):
        paths_of(replace(table, angle=angle), PLAIN)
