"""Replays: where every link of one robot was, at a rate that an eye can follow, and a compact text of it for the page.

A replay is made from a trace: a state after each step of 1/60 s. Two steps make a frame, so 30 frames a second.
"""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import TypedDict

import numpy as np
import numpy.typing as npt

from tasks.design import N_LINKS, Designs

STEPS_PER_SECOND = 60
STEPS_PER_FRAME = 2

QUANTUM = 1e-3
"""Step of the encoded coordinates [m and rad]: what the page shows is within half of it of the trace."""


@dataclass(frozen=True, eq=False)
class Replay:
    """One robot in one world.

    Attributes:
        title: what a reader is told that this is.
        environment: name of where the design evolved, which gives the robot its colour; "" where it is not known.
        world: where it is seen, in words.
        depth: of the ground below y = 0 [m].
        has_medium: whether something fills the world below y = 0.
        length_scale: (n_links,) long axis of each link [m]; its width is the reciprocal.
        parent: (n_links,) index of each link's parent, -1 for the root.
        parent_attachment: (n_links,) joint's place on the parent's long axis [half heights].
        frames: (n_frames, n_links, 3) x, y [m], angle [rad].
        fps: frames a second.
    """

    title: str
    environment: str
    world: str
    depth: float
    has_medium: bool
    length_scale: npt.NDArray[np.float64]
    parent: npt.NDArray[np.int64]
    parent_attachment: npt.NDArray[np.float64]
    frames: npt.NDArray[np.float64]
    fps: float = STEPS_PER_SECOND / STEPS_PER_FRAME

    @property
    def duration(self) -> float:
        """Time from the first frame to the last [s]."""
        return (len(self.frames) - 1) / self.fps

    def at(self, time: float) -> npt.NDArray[np.float64]:
        """Interpolate the links between frames at a time [s]; (n_links, 3) x, y, angle."""
        place = min(max(time * self.fps, 0.0), len(self.frames) - 1)
        before = min(int(place), len(self.frames) - 2)
        share = place - before
        pose: npt.NDArray[np.float64] = (1 - share) * self.frames[before] + share * self.frames[before + 1]
        return pose


def replay_of(
    design: Designs,
    trace: npt.NDArray[np.floating],
    *,
    title: str,
    environment: str,
    world: str,
    depth: float,
    has_medium: bool,
    n_settle: int,
) -> Replay:
    """Make a replay of one design from the trace of its rollout.

    Args:
        design: the one design.
        trace: (n_steps, n_links, 6) as from :func:`tasks.simulation.simulate`.
        title: what a reader is told that this is.
        environment: name of where the design evolved, or "".
        world: where it is seen, in words.
        depth: of the ground [m].
        has_medium: whether something fills the world below y = 0.
        n_settle: steps at the start that are left out, as they are from the displacement; 0 shows them.

    Raises:
        ValueError: the trace is not that of one design, too short, or of a rollout that diverged.
    """
    if len(design) != 1:
        raise ValueError(f"replay {title!r}: {len(design)} designs, expected one")
    if trace.ndim != 3 or trace.shape[1:] != (N_LINKS, 6):
        raise ValueError(f"replay {title!r}: trace has shape {trace.shape}, expected (n_steps, {N_LINKS}, 6)")
    # A trace's first entry is the state after the first step, so the settled state is entry n_settle - 1.
    frames = trace[max(n_settle - 1, 0) :: STEPS_PER_FRAME, :, :3].astype(np.float64)
    if len(frames) < 2:
        raise ValueError(f"replay {title!r}: {len(trace)} steps, expected {n_settle + STEPS_PER_FRAME} or more")
    if not np.isfinite(trace).all():
        raise ValueError(f"replay {title!r}: the rollout diverged, there is nothing to show")
    return Replay(
        title=title,
        environment=environment,
        world=world,
        depth=float(depth),
        has_medium=has_medium,
        length_scale=design.length_scale[0],
        parent=design.parent[0],
        parent_attachment=design.parent_attachment[0],
        frames=frames,
    )


class EncodedReplay(TypedDict):
    """A replay as the page's JSON has it; viewer.js undoes it."""

    title: str
    environment: str
    world: str
    depth: float
    hasMedium: bool
    fps: float
    lengthScale: list[float]
    parent: list[int]
    parentAttachment: list[float]
    quantum: float
    first: list[int]
    """n_links × (x, y, angle) of the first frame, in quanta."""
    steps: str
    """base64 of little-endian int16, (n_frames - 1, n_links, 3): from each frame to the next, in quanta."""


def encode(replay: Replay) -> EncodedReplay:
    """Put a replay into plain JSON values, 48 characters a frame; the same replay always gives the same.

    Coordinates are rounded to a quantum before their differences are taken, so errors do not add up: each stays within
    half a quantum. It is 1 mm and 1 mrad, unless something moves by more than 32 m or rad within a frame.
    """
    frames = replay.frames
    fastest = float(np.abs(np.diff(frames, axis=0)).max())
    quantum = max(QUANTUM, fastest / (np.iinfo(np.int16).max - 1))
    quanta = np.rint(frames / quantum).astype(np.int64)
    steps = np.diff(quanta, axis=0).astype("<i2")
    return EncodedReplay(
        title=replay.title,
        environment=replay.environment,
        world=replay.world,
        depth=replay.depth,
        hasMedium=replay.has_medium,
        fps=replay.fps,
        lengthScale=[round(float(length), 4) for length in replay.length_scale],
        parent=[int(parent) for parent in replay.parent],
        parentAttachment=[round(float(place), 4) for place in replay.parent_attachment],
        quantum=quantum,
        first=[int(value) for value in quanta[0].ravel()],
        steps=base64.b64encode(steps.tobytes()).decode("ascii"),
    )
