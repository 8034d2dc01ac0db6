"""A synthetic camera before a robot: `python -m benchmarks.synthetic_run --kit KIT --out DIR` films a run of its robot.

The robot does what it does in the simulation that the kit records, but its joints rise from rest as the servos' do.
Beside the video come the printed board, the markers file and the tracks that are true, so that `puddle compare-run` can
be tried without a robot, or with a robot that swims slower than its simulation (--slower).
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from benchmarks.synthetic_tank import TankCamera, TankScene, film_board, sticker
from pipeline.bench.vision.markers_file import Markers, TaggedBar, markers_of
from pipeline.bench.vision.video import film
from pipeline.commands.run_comparison import read_kit
from pipeline.store.tables import Columns, csv_of
from tasks.analysis.built_run import BuiltRobot
from tasks.arrays import Float64
from tasks.bench.fabrication.kit_settings import KitSettings, ThrowingKit
from tasks.bench.fabrication.throwing_bars import throwing_bars
from tasks.bench.fabrication.timeline import Playback, driven_joints, envelope
from tasks.design import N_LINKS, rest_pose
from tasks.seeding import generator
from tasks.simulation import simulate

_TANK = ThrowingKit(tank_length=1.1, tank_height=0.62, waterline=0.32)
_BEFORE = 1.0  # from the start of the video to that of the servos [s]
_START = 0.25  # where the root begins in the tank [m]
_N_INSTANTS = 4  # over which an exposure is averaged


def motion_of(robot: BuiltRobot, seconds: float, slower: float) -> tuple[Float64, Float64]:
    """Simulate a kit's robot.

    Args:
        robot: the robot.
        seconds: duration at bench scale [s].
        slower: factor of the root's path along x; the gait stays as it is.

    Returns:
        (n_steps,) times since the servos began [s], and (n_steps, n_links, 3) poses at bench scale, over the waterline.
    """
    step = robot.physics.time_step * robot.time_scale
    n_steps = int(np.ceil(seconds / step))
    rollout = simulate(
        robot.design, robot.environment, n_settle=0, n_measure=n_steps, trace=True, physics=robot.physics
    )
    assert rollout.trace is not None
    poses = rollout.trace[0, :, :, :3].astype(np.float64) * (robot.scale, robot.scale, 1.0)
    time = step * (1 + np.arange(n_steps))
    poses = _risen(robot, time, poses)
    root = poses[:, :1, 0] - poses[0, 0, 0]
    poses[:, :, 0] += (slower - 1) * root
    return time, poses


def _risen(robot: BuiltRobot, time: Float64, poses: Float64) -> Float64:
    """Lower the angles of the joints by the timeline's envelope while it rises. The root's path stays."""
    ramp, parent = Playback().ramp, robot.design.parent[0]
    rising = np.flatnonzero(time < ramp)
    seen = poses[rising]
    share = envelope(time[rising], duration=time[-1] + ramp, ramp=ramp)[:, None]
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


def film_run(out: Path, scene: TankScene, robot: BuiltRobot, seconds: float, slower: float) -> Columns:
    """Film a run.

    Args:
        out: the MP4 file.
        scene: tank and camera.
        robot: the robot.
        seconds: duration from the start of the servos on [s].
        slower: factor of the path along x.

    Returns:
        The true tracks, in the columns of a tracks file whose throws are links.
    """
    camera, parts = scene.camera, parts_of(robot, scene.markers)
    time, poses = motion_of(robot, seconds, slower)
    shift = np.array((_START - poses[0, 0, 0], 0.0, 0.0))
    rows: list[tuple[float, ...]] = []
    with film(out, width=camera.width, height=camera.height, rate=camera.rate, quality=camera.quality) as add:
        for frame in range(round((_BEFORE + seconds) * camera.rate)):
            opens = frame / camera.rate
            if frame and scene.rng.random() < camera.drop:
                continue
            instants = opens - _BEFORE + camera.exposure * (np.arange(_N_INSTANTS) + 0.5) / _N_INSTANTS
            seen = [
                np.column_stack([np.interp(instants, time, poses[:, link, i]) for i in range(3)]) + shift
                for link in range(N_LINKS)
            ]
            add(scene.shot([(bar, seen[link] + (0.0, scene.level, 0.0)) for link, bar in parts]), opens)
            rows += [(link, opens, *seen[link].mean(axis=0)) for link in range(N_LINKS)]
    table = np.array(rows)
    tracks: Columns = {"throw": table[:, 0].astype(int)}
    return tracks | {name: table[:, i] for i, name in enumerate(("time", "x", "y", "angle"), 1)}


def main() -> None:
    """Film a run and a board, and write what is true of them."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--kit", type=Path, required=True)
    options.add_argument("--out", type=Path, required=True)
    options.add_argument("--seconds", type=float, default=20.0)
    options.add_argument("--slower", type=float, default=1.0)
    given = options.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    markers, rng = markers_of(_TANK, throwing_bars(_TANK, KitSettings(), 1000.0)), generator(0, "synthetic run")
    scene = TankScene(TankCamera(exposure=0.004), markers, rng=rng)
    tracks = film_run(given.out / "run.mp4", scene, read_kit(given.kit), given.seconds, given.slower)
    (given.out / "run.csv").write_bytes(csv_of(tracks))
    film_board(given.out / "board.mp4", scene.camera, markers, 12, rng)
    document = yaml.safe_dump(markers.model_dump(mode="json"), sort_keys=False)
    (given.out / "markers.yaml").write_text(document, encoding="utf-8")
    print(f"{given.seconds:g} s of a run in {given.out}")


if __name__ == "__main__":
    main()
