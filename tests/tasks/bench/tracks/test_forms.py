"""Tracks as programs for pictures, phones and editors give them: what is repaired, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from tank import filmed

from tasks.bench.tracks import TrackError, Tracks, TrackTable
from tasks.bench.tracks.residuals import check_throws
from tasks.bench.tracks.table import paths_of
from tasks.world import Physics

PLAIN = Tracks(file="tracks.csv")
N = 12  # throws


@pytest.fixture(scope="module", params=[60.0, 120.0])
def table(request) -> TrackTable:
    """Bars that spin, as filmed, to the 0.01 mm and 0.01° that files often hold."""
    plain, _ = filmed(N, rate=request.param, seconds=1.2, noise_mm=0.1, noise_deg=0.1)
    spun = plain.angle + np.repeat(np.linspace(-4, 4, N), len(plain.time) // N) * 4 * plain.time
    return replace(plain, x=plain.x.round(5), y=plain.y.round(5), angle=spun.round(4))


def tilt(angle):
    return np.abs(np.remainder(angle + np.pi / 2, np.pi) - np.pi / 2)


@pytest.mark.parametrize("known", [lambda angle: angle % np.pi, lambda angle: (angle + 1) % np.pi - 1])
def test_half_turns_of_ellipses_and_moments_are_repaired(table: TrackTable, known) -> None:
    repaired, true = paths_of(replace(table, angle=known(table.angle)), PLAIN), paths_of(table, PLAIN)
    assert (repaired.period, true.period) == (np.pi, 2 * np.pi)
    half_turns = (repaired.pose - true.pose)[..., 2] / np.pi
    np.testing.assert_allclose(half_turns, np.round(half_turns[:, :1]) + 0 * half_turns, atol=1e-9)


@pytest.mark.parametrize(
    ("known", "message"),
    [
        (lambda angle: angle % (np.pi / 2), r"throw \d+, frame \d+: the angle jumps by a quarter turn.*minAreaRect"),
        (lambda angle: -((-angle) % (np.pi / 2)), "jumps by a quarter turn"),  # as OpenCV gave them before 4.5.1
        (tilt, r"throw \d+, frame \d+: the angle turns back as fast as it came, as in \d+ other places: .* tilt"),
        (lambda angle: np.arcsin(np.sin(angle)), "turns back as fast as it came"),
        (lambda angle: np.arccos(np.cos(angle)), "turns back as fast as it came"),
    ],
)
def test_angles_that_tell_less_are_refused_by_name(table: TrackTable, known, message: str) -> None:
    for unit in ("rad", "deg"):
        angle = np.degrees(known(table.angle)) if unit == "deg" else known(table.angle)
        with pytest.raises(TrackError, match=message):
            paths_of(replace(table, angle=angle), Tracks(file="tracks.csv", angle_unit=unit))


def again(table: TrackTable, repeats) -> tuple[TrackTable, np.ndarray]:
    """Repeat poses in the frames whose number within the throw is among some; returns which frames are new, too."""
    frame = np.arange(len(table.time)) % (len(table.time) // N)
    new = ~repeats(frame)
    shown = np.maximum.accumulate(np.where(new, np.arange(len(frame)), 0))
    return replace(table, x=table.x[shown], y=table.y[shown], angle=table.angle[shown]), new


@pytest.mark.parametrize(
    "repeats",
    [
        lambda frame: frame % 2 == 1,
        lambda frame: frame % 3 != 0,
        lambda frame: frame % 4 != 0,
        lambda frame: frame % 6 == 5,
        lambda frame: np.isin(frame % 12, (5, 6, 7)),  # a phone that hangs
        lambda frame: frame < 0,
    ],
)
def test_frames_that_repeat_are_dropped_and_counted(table: TrackTable, repeats) -> None:
    given, new = again(table, repeats)
    paths = paths_of(given, PLAIN)
    # Of noise alone, a bar now and then moves less than 3 of the last digits, or turns back, between two pictures.
    assert 0.97 * (~new).sum() <= paths.n_repeated <= (~new).sum()
    assert paths.seen.sum() + paths.n_repeated == len(new)
    true = paths_of(TrackTable(*(getattr(table, name)[new] for name in ("throw", "time", "x", "y", "angle"))), PLAIN)
    intervals = [np.median(np.diff(throws.time, axis=1)[throws.seen[:, 1:]]) for throws in (paths, true)]
    assert intervals[0] == pytest.approx(intervals[1])


def test_a_bar_that_rests_or_is_coarsely_resolved_repeats_nothing(table: TrackTable) -> None:
    """One that is held for 5 frames and rests for 5, and a slow one to the millimetre and degree."""
    n = len(table.time) // N
    held = np.clip(np.arange(n), 5, n - 6)
    shown = (np.arange(0, N * n, n)[:, None] + held).ravel()
    assert paths_of(replace(table, x=table.x[shown], y=table.y[shown], angle=table.angle[shown]), PLAIN).n_repeated == 0
    frame = np.tile(np.arange(n), N)
    slow = replace(table, x=(0.0004 * frame).round(3), y=(-0.0003 * frame).round(3), angle=(0.01 * frame).round(2))
    slow = replace(slow, angle=np.radians(np.degrees(0.004 * frame).round()))
    assert paths_of(slow, PLAIN).n_repeated == 0


@pytest.mark.parametrize("noise", [0.0, 2e-4])
def test_bars_that_never_move_are_refused_by_name(noise: float) -> None:
    table, bars = filmed(4)
    rng, n = np.random.default_rng(1), len(table.time)
    at_rest = replace(table, **{name: -0.1 + noise * rng.standard_normal(n) for name in ("x", "y", "angle")})
    with pytest.raises(TrackError, match=r"throw 0: the bar is at rest in all 16 frames, expected it to move"):
        check_throws(at_rest, bars, PLAIN, Physics())
    if not noise:
        still = table.throw == 2
        held = replace(table, **{name: np.where(still, 0.1, getattr(table, name)) for name in ("x", "y", "angle")})
        with pytest.raises(TrackError, match="throw 2: the bar is at rest in all 16 frames"):
            check_throws(held, bars, PLAIN, Physics())
