"""Rollouts of free bars: the base simulator's step, starts that meet the frames."""

import numpy as np
import torch

from tasks.residual.rollouts import SeenPaths, follow
from tasks.simulation.free_links import FreeLinks
from tasks.world import Physics

PHYSICS = Physics()
DT = PHYSICS.time_step


class Constant:
    """A medium that accelerates every bar alike."""

    def __call__(self, length_scale, pose, velocity):
        return torch.full_like(velocity, 0.01)


def seen_paths(time, pose, velocity, length_scale, begins=None) -> SeenPaths:
    """Exact poses at (n_throws, n_frames) times, with a first estimate of velocities."""
    starts = np.zeros(time.shape, dtype=bool)
    starts[:, 0] = True
    everywhere = np.ones(time.shape, dtype=bool)
    sd = np.full(pose.shape, 1e-6)
    return SeenPaths(time, pose, sd, velocity, everywhere, starts if begins is None else begins, length_scale)


def test_a_rollout_meets_the_frames_of_the_base_simulators_own_path() -> None:
    """Each step adds 0.01 and gravity to the velocity, and then the velocity to the pose."""
    links, rows = FreeLinks(np.ones(1), PHYSICS), [np.array([[0, 2, 1, 3, 0.5, -2]], np.float32)]
    for _ in range(20):
        pushed = rows[-1].copy()
        pushed[:, 3:] += np.float32(0.01)
        rows.append(links.step(pushed, None))
    path = np.stack(rows, axis=1).astype(np.float64)
    frames, time = path[:, ::4, :3], np.arange(0, 21, 4)[None] * DT
    wrong = np.random.default_rng(1).normal(scale=5.0, size=frames.shape)  # first estimates
    steps = np.arange(21)[None] * DT
    pose, velocity = follow(Constant(), seen_paths(time, frames, wrong, np.ones(1)), steps, PHYSICS)
    np.testing.assert_allclose(pose, path[..., :3], atol=1e-3)
    np.testing.assert_allclose(velocity, path[..., 3:], atol=2e-2)


def test_what_follows_a_contact_is_another_motion() -> None:
    time = np.arange(9)[None] * 4 * DT
    pose = np.zeros((1, 9, 3))
    pose[..., 0] = 3 * (1 - np.abs(1 - time / time[0, 4]))  # at 11 m/s to a wall and back
    begins = np.zeros((1, 9), dtype=bool)
    begins[:, [0, 4]] = True
    rng = np.random.default_rng(1)
    found = seen_paths(time, pose, rng.normal(size=pose.shape), np.ones(1), begins)
    followed, _ = follow(Constant(), found, time, Physics(gravity=0.0))
    np.testing.assert_allclose(followed[..., 0], pose[..., 0], atol=0.02)
