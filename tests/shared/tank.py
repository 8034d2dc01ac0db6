"""Thrown bars in a slush that stands in for a tank, as a camera sees them: tracks for the tests."""

from pathlib import Path

import numpy as np

from tasks.bench.tracks import Bars, TrackTable
from tasks.residual import Throws, initial_states
from tasks.simulation.free_links import FreeLinks
from tasks.world import Medium, Physics, Slush, froude_time

SCALE = 0.07
FINE = 960  # steps of the tank in a second of simulation


def filmed(
    n_throws: int,
    *,
    rate: float = 60.0,
    seconds: float = 1.0,
    noise_mm: float = 0.0,
    noise_deg: float = 0.0,
    medium: Medium = Slush(),  # noqa: B008 (frozen)
) -> tuple[TrackTable, Bars]:
    """Film throws at the bench's scale: ``rate`` frames a second of the bench, ``seconds`` of simulation."""
    throws = Throws(n_throws=n_throws, y_reach=2.0, max_velocity=4.0, max_omega=3.0)
    starts = initial_states(throws, np.random.default_rng(5))
    links, now = FreeLinks(starts.length_scale, Physics(time_step=1 / FINE)), starts.state
    poses = [now[:, :3]]
    for _ in range(round(seconds * FINE)):
        now = links.step(now, medium)
        poses.append(now[:, :3])
    time = np.arange(int(seconds * froude_time(SCALE) * rate) + 1) / rate
    frame = np.minimum((time / froude_time(SCALE) * FINE).round().astype(int), len(poses) - 1)
    pose = np.stack(poses, axis=1)[:, frame].astype(np.float64) * (SCALE, SCALE, 1)
    noise = np.array([noise_mm / 1000, noise_mm / 1000, np.radians(noise_deg)])
    pose += np.random.default_rng(6).normal(size=pose.shape) * noise
    n_frames = len(time)
    table = TrackTable(np.repeat(np.arange(n_throws), n_frames), np.tile(time, n_throws), *pose.reshape(-1, 3).T)
    length = starts.length_scale * SCALE
    return table, Bars(np.arange(n_throws), length, SCALE**2 / length, np.full(n_throws, 0.098))


def write_tracks(table: TrackTable, bars: Bars, path: Path) -> None:
    """Write a tracks file and its bars beside it."""
    columns = [table.throw, table.time, table.x, table.y, table.angle]
    np.savetxt(path, np.stack(columns, axis=1), "%d,%.6f,%.9f,%.9f,%.9f", header="throw,time,x,y,angle", comments="")
    of_bars = np.stack([bars.throw, bars.length, bars.width, bars.mass], axis=1)
    beside = path.with_name(f"{path.stem}-bars.csv")
    np.savetxt(beside, of_bars, "%d,%.9f,%.9f,%.6f", header="throw,length,width,mass", comments="")
