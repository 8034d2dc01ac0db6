"""Replays: the pose of every link of one robot over time, and a compact encoding of it for the page.

A replay is made from a trace, which has a state after each step. Two steps make a frame, so steps of 1/60 s give 30
frames per second.
"""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from tasks.arrays import Float64, Floats, Int64
from tasks.design import Designs
from tasks.simulation import Rollouts
from tasks.simulation.scenes import scenes_along
from tasks.world import Environment, Physics
from tasks.world.medium import Scene

STEPS_PER_SECOND = 60  # steps per second of a trace with the paper's time step
STEPS_PER_FRAME = 2
FILM_FPS = STEPS_PER_SECOND // STEPS_PER_FRAME  # pictures per second of a film: every frame of a replay

QUANTUM = 1e-3  # step of the encoded coordinates [m and rad]; the page is within half of it of the trace


_PHYSICS = Physics()


@dataclass(frozen=True, eq=False)
class Replay:
    """One robot in one environment."""

    title: str  # heading for the reader
    seen_in: str  # where it is seen, in words
    depth: float  # depth of the ground below y = 0 [m]
    has_medium: bool  # whether there is a medium below y = 0
    hallucinated: bool  # whether networks predict it; its surface is then dashed
    length_scale: Float64  # (n_links,) long axis of each link [m]; its width is the reciprocal
    parent: Int64  # (n_links,) index of each link's parent, -1 for the root
    parent_attachment: Float64  # (n_links,) position of the joint on the parent's long axis [half heights]
    frames: Float64  # (n_frames, n_links, 3) x, y [m], angle [rad]
    scenes: Sequence[Scene] = ()  # n_frames of the medium, if it shows more than a level surface
    fps: float = STEPS_PER_SECOND / STEPS_PER_FRAME  # frames per second
    environment: str = ""  # where the design evolved; "" if unknown
    disagreement: Float64 | None = None  # (n_frames, n_links) of the members of an ensemble [m/s²]; NaN where unknown
    color: str = "#566270"  # of the robot in a film: that of the arm where it evolved
    robot: str = ""  # address of the robot on the page and name of its design file; "" if it has none
    group: str = ""  # heading of the viewer's list under which it is found, such as "Residual Slush, 9 m"
    in_target: bool = False  # whether it is seen where champions are transferred to
    command: str = ""  # environment of `puddle simulate` that shows the same; empty for a single network
    best: bool = False  # whether it is of the best champion of its arm
    arm_mean: float = 0.0  # zero-shot score of its arm: the mean over trials
    score: float = 0.0  # zero-shot score of the robot

    @property
    def displacement(self) -> float:
        """Displacement of the root from the first frame to the last [m]."""
        return float(self.frames[-1, 0, 0] - self.frames[0, 0, 0])

    @property
    def duration(self) -> float:
        """Time from the first frame to the last [s]."""
        return (len(self.frames) - 1) / self.fps

    def at(self, times: Float64) -> Float64:
        """Interpolate the poses between frames at (n_times,) times [s]; (n_times, n_links, 3) x, y, angle."""
        place = np.clip(times * self.fps, 0.0, len(self.frames) - 1)
        before = np.minimum(place.astype(int), len(self.frames) - 2)
        share = (place - before)[:, None, None]
        poses: Float64 = (1 - share) * self.frames[before] + share * self.frames[before + 1]
        return poses


def link_corners(pose: Float64, length: Float64) -> Float64:
    """Return the corners of links, (..., 4, 2) x, y [m], from (..., 3) poses x, y, angle and long axes [m]."""
    across, along = np.multiply.outer(0.5 / length, (1, -1, -1, 1)), np.multiply.outer(0.5 * length, (1, 1, -1, -1))
    x, y, angle = (part[..., None] for part in np.moveaxis(pose, -1, 0))
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([x + cos * across - sin * along, y + sin * across + cos * along], axis=-1)


def at_frames(by_step: Floats, n_settle: int) -> Float64:
    """Select from (n_steps, ...) values after each step those at a replay's frames: (n_frames, ...)."""
    # The first entry of a trace is the state after the first step, so the settled state is entry n_settle - 1.
    return by_step[max(n_settle - 1, 0) :: STEPS_PER_FRAME].astype(np.float64)


def shown_trace(rollouts: Rollouts, environment: Environment) -> tuple[Floats, int | None]:
    """Return the (n_steps, n_links, 6) trace of a single design; in an ensemble that of the median member, its number.

    Of two members in the middle it is the lower one. Those that diverged do not count.
    """
    assert rollouts.trace is not None
    if not environment.is_ensemble:
        return rollouts.trace[0], None
    displacement = rollouts.displacement[:, 0]
    ranked = np.argsort(displacement, kind="stable")  # NaN, for a rollout that diverged, comes last
    member = int(ranked[max(int(np.isfinite(displacement).sum()) - 1, 0) // 2])
    return rollouts.trace[member, 0], member


def replay_of(
    design: Designs,
    trace: Floats,
    environment: Environment,
    *,
    title: str,
    seen_in: str,
    n_settle: int,
    hallucinated: bool = False,
    physics: Physics = _PHYSICS,
) -> Replay:
    """Return the replay of a design from a finite (n_steps, n_links, 6) trace, without ``n_settle`` steps at the start.

    The other arguments are fields of :class:`Replay`.
    """
    design = design.compact()  # as the trace is
    return Replay(
        title=title,
        seen_in=seen_in,
        depth=float(environment.depth),
        has_medium=environment.medium is not None,
        hallucinated=hallucinated,
        length_scale=design.length_scale[0],
        parent=design.parent[0],
        parent_attachment=design.parent_attachment[0],
        frames=at_frames(trace[..., :3], n_settle),
        scenes=scenes_along(design, trace, environment, physics)[max(n_settle - 2, 0) :: STEPS_PER_FRAME],
        fps=1 / (STEPS_PER_FRAME * physics.time_step),
    )


def encode(replay: Replay) -> dict[str, Any]:
    """Convert a replay to plain JSON values for robot.js; equal replays give equal values.

    Coordinates are int16 multiples of a quantum: 1 mm and 1 mrad, or more if the robot gets farther than 32 m.
    """
    quantum = max(QUANTUM, float(np.abs(replay.frames).max()) / np.iinfo(np.int16).max)
    return {
        **{name: getattr(replay, name) for name in _ENCODED},
        "length_scale": [round(float(length), 4) for length in replay.length_scale],
        "parent": replay.parent.tolist(),
        "parent_attachment": [round(float(place), 4) for place in replay.parent_attachment],
        "quantum": quantum,
        "frames": _base64(np.rint(replay.frames / quantum).astype("<i2")),  # (n_frames, n_links, 3), in quanta
        "disagreement": None if replay.disagreement is None else _encode_disagreement(replay.disagreement),
    }


_ENCODED = ("title", "robot", "environment", "command", "seen_in", "depth", "has_medium", "hallucinated", "fps")


def _encode_disagreement(values: Float64) -> dict[str, Any]:
    known = values[np.isfinite(values)]
    # The 95th percentile, so that peaks do not make the rest pale.
    most = max(float(np.quantile(known, 0.95)) if len(known) else 0.0, 1e-9)
    levels = np.nan_to_num(np.rint(np.clip(values / most, 0, 1) * 254), nan=255)
    return {
        "most": float(f"{most:.4g}"),  # value of level 254 [m/s²]
        # uint8, (n_frames, n_links): shares of ``most`` in 254ths; 255 where there is no value.
        "levels": _base64(levels.astype(np.uint8)),
    }


def _base64(array: npt.NDArray[Any]) -> str:
    return base64.b64encode(array.tobytes()).decode("ascii")
