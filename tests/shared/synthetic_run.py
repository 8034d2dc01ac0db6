"""A synthetic camera before a robot, which films a run of it.

The robot does what it does in the simulation that a kit records, or swims slower; its joints rise from rest as the
servos' do.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from synthetic_tank import TankScene, sticker

from pipeline.bench.vision.markers_file import Markers, TaggedBar
from tasks.analysis.built_run import BuiltRobot
from tasks.arrays import Float64
from tasks.bench.fabrication.timeline import RAMP, driven_joints, envelope
from tasks.design import N_LINKS, rest_pose
from tasks.simulation import simulate

_BEFORE = 1.0  # from the start of the video to that of the servos [s]
_START = 0.25  # where the root begins in the tank [m]


def motion_of(robot: BuiltRobot, seconds: float, slower: float) -> tuple[Float64, Float64]:
    """Simulate a kit's robot for a time [s], its path along x multiplied by ``slower``; the gait stays as it is.

    Returns (n_steps,) times since the servos began [s], and (n_steps, n_links, 3) poses at bench scale.
    """
    step = robot.physics.time_step * robot.time_scale
    n_steps = int(np.ceil(seconds / step))
    rollout = simulate(
        robot.design, robot.environment, n_settle=0, n_measure=n_steps, trace=True, physics=robot.physics
    )
    poses = rollout.trace[0, :, :, :3].astype(np.float64) * (robot.scale, robot.scale, 1.0)
    time = step * (1 + np.arange(n_steps))
    poses = _risen(robot, time, poses)
    poses[:, :, 0] += (slower - 1) * (poses[:, :1, 0] - poses[0, 0, 0])
    return time, poses


def _risen(robot: BuiltRobot, time: Float64, poses: Float64) -> Float64:
    """Lower the angles of the joints by the timeline's envelope while it rises. The root's path stays."""
    parent = robot.design.parent[0]
    rising = np.flatnonzero(time < RAMP)
    seen = poses[rising]
    share = envelope(time[rising], duration=time[-1] + RAMP, ramp=RAMP)[:, None]
    joints = list(driven_joints(robot.design))
    angle = seen[:, joints, 2] - seen[:, parent[joints], 2] - robot.design.rest_angle[0, joints]
    bodies = robot.design[np.zeros(len(rising), dtype=int)]
    turned = bodies.rest_angle.copy()
    turned[:, joints] += share * angle
    x, y, angles = rest_pose(replace(bodies, rest_angle=turned))
    cosine, sine = np.cos(seen[:, :1, 2]), np.sin(seen[:, :1, 2])
    risen = poses.copy()
    risen[rising, :, 0] = seen[:, :1, 0] + robot.scale * (cosine * x - sine * y)
    risen[rising, :, 1] = seen[:, :1, 1] + robot.scale * (sine * x + cosine * y)
    risen[rising, :, 2] = seen[:, :1, 2] + angles
    return risen


def parts_of(robot: BuiltRobot, markers: Markers) -> list[tuple[int, TaggedBar]]:
    """Return what the camera sees, from the back to the front: links from the last to the root, then their tags."""
    tags = markers.robot
    length = robot.scale * robot.design.length_scale[0]
    bodies = [
        (link, tagged.model_copy(update={"length": length[link], "width": robot.scale**2 / length[link]}))
        for link, tagged in enumerate(tags.bars())
    ]
    return bodies[::-1] + [(link, sticker(tags.first + link, tags.tag_size)) for link in reversed(range(N_LINKS))]


def film_run(out: Path, scene: TankScene, robot: BuiltRobot, seconds: float, slower: float) -> dict[str, Float64]:
    """Film a run from a second before the servos start. Returns the true tracks, whose throws are links."""
    parts = parts_of(robot, scene.markers)
    time, poses = motion_of(robot, seconds, slower)
    poses[..., 0] += _START - poses[0, 0, 0]

    def pose_at(instants: Float64, link: int) -> Float64:
        return np.column_stack([np.interp(instants - _BEFORE, time, poses[:, link, i]) for i in range(3)])

    n_frames = round((_BEFORE + seconds) * scene.camera.rate)
    held = scene.film(out, n_frames, lambda instants: [(bar, pose_at(instants, link)) for link, bar in parts])
    opens = [round(instants[0] * scene.camera.rate) / scene.camera.rate for instants in held]
    rows = [
        (link, time, *pose_at(instants, link).mean(axis=0))
        for time, instants in zip(opens, held, strict=True)
        for link in range(N_LINKS)
    ]
    return dict(zip(("throw", "time", "x", "y", "angle"), np.array(rows).T, strict=True))
