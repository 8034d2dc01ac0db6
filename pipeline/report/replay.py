"""Replays: where every link of one robot was, at a rate that an eye can follow, and a compact text of it for the page.

A replay is made from a trace: a state after each step. Two steps make a frame, so of steps of 1/60 s there are 30
frames a second.
"""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import TypedDict

import numpy as np
import numpy.typing as npt

from tasks.design import N_LINKS, Designs
from tasks.world import Physics

STEPS_PER_SECOND = 60
"""Of a trace whose time step is the paper's."""
STEPS_PER_FRAME = 2

QUANTUM = 1e-3
"""Step of the encoded coordinates [m and rad]: what the page shows is within half of it of the trace."""


MOST_ACCELERATION = 60.0
"""Beyond which an arrow of the medium's push grows no longer [m/s²]; six times gravity."""


@dataclass(frozen=True, eq=False)
class Overlay:
    """A number for every link at every frame, shown as its colour and along a time line."""

    label: str
    """What it is, for a reader."""
    unit: str
    """Such as "m/s²", or "× usual"."""
    values: npt.NDArray[np.float64]
    """(n_frames, n_links), not negative; NaN where there is none."""
    darkest_at_least: float = 0.0
    """Value that the darkest colour stands for at least, so that what is harmless never looks alarming."""


@dataclass(frozen=True, eq=False)
class Replay:
    """One robot in one world.

    Attributes:
        title: what a reader is told that this is.
        environment: name of where the design evolved, which gives the robot its colour; "" where it is not known.
        world: where it is seen, in words.
        depth: of the ground below y = 0 [m].
        has_medium: whether something fills the world below y = 0.
        imagined: whether that is what networks make of it; its surface is then dashed.
        other_medium: whether it is another than True Slush is filled with.
        length_scale: (n_links,) long axis of each link [m]; its width is the reciprocal.
        parent: (n_links,) index of each link's parent, -1 for the root.
        parent_attachment: (n_links,) joint's place on the parent's long axis [half heights].
        frames: (n_frames, n_links, 3) x, y [m], angle [rad].
        fps: frames a second.
        overlays: what else is known of each link at each frame.
        push: (n_frames, n_links, 2) acceleration that the medium gives each link [m/s²], where it is known.
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
    overlays: tuple[Overlay, ...] = ()
    push: npt.NDArray[np.float64] | None = None
    imagined: bool = False
    other_medium: bool = False

    def __post_init__(self) -> None:
        shape = self.frames.shape[:2]
        for overlay in self.overlays:
            if overlay.values.shape != shape:
                raise ValueError(
                    f"replay {self.title!r}: overlay {overlay.label!r} has shape {overlay.values.shape}, "
                    f"expected {shape}"
                )
        if self.push is not None and self.push.shape != (*shape, 2):
            raise ValueError(f"replay {self.title!r}: push has shape {self.push.shape}, expected {(*shape, 2)}")

    @property
    def in_true_slush(self) -> bool:
        """Whether it shows what the robot truly does in slush."""
        return self.has_medium and not self.imagined and not self.other_medium

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


def at_frames(by_step: npt.NDArray[np.floating], n_settle: int) -> npt.NDArray[np.float64]:
    """Take from (n_steps, ...) values after each step those of a replay's frames: (n_frames, ...)."""
    # A trace's first entry is the state after the first step, so the settled state is entry n_settle - 1.
    return by_step[max(n_settle - 1, 0) :: STEPS_PER_FRAME].astype(np.float64)


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
    time_step: float = Physics().time_step,
    imagined: bool = False,
    other_medium: bool = False,
    overlays: tuple[Overlay, ...] = (),
    push: npt.NDArray[np.float64] | None = None,
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
        time_step: from each state of the trace to the next [s]; as in a rollout, the paper's unless said.
        imagined: whether networks make up what fills it.
        other_medium: whether it is filled with something else than True Slush.
        overlays: of the frames, see :func:`at_frames`.
        push: of the frames.

    Raises:
        ValueError: the trace is not that of one design, too short, or of a rollout that diverged.
    """
    if len(design) != 1:
        raise ValueError(f"replay {title!r}: {len(design)} designs, expected one")
    if trace.ndim != 3 or trace.shape[1:] != (N_LINKS, 6):
        raise ValueError(f"replay {title!r}: trace has shape {trace.shape}, expected (n_steps, {N_LINKS}, 6)")
    frames = at_frames(trace[..., :3], n_settle)
    if len(frames) < 2:
        n_least = max(n_settle, 1) + STEPS_PER_FRAME
        raise ValueError(f"replay {title!r}: {len(trace)} steps, expected {n_least} or more")
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
        fps=1 / (STEPS_PER_FRAME * time_step),
        overlays=overlays,
        push=push,
        imagined=imagined,
        other_medium=other_medium,
    )


class EncodedOverlay(TypedDict):
    """An overlay as the page's JSON has it."""

    label: str
    unit: str
    most: float
    """The value that 254 stands for: the 95th percentile, so that spikes do not pale the rest."""
    levels: str
    """base64 of uint8, (n_frames, n_links): shares of ``most`` in 254ths; 255 where there is no value."""


class EncodedReplay(TypedDict):
    """A replay as the page's JSON has it; viewer.js undoes it."""

    title: str
    environment: str
    world: str
    depth: float
    hasMedium: bool
    imagined: bool
    fps: float
    lengthScale: list[float]
    parent: list[int]
    parentAttachment: list[float]
    quantum: float
    first: list[int]
    """n_links × (x, y, angle) of the first frame, in quanta."""
    steps: str
    """base64 of little-endian int16, (n_frames - 1, n_links, 3): from each frame to the next, in quanta."""
    overlays: list[EncodedOverlay]
    pushQuantum: float
    """Step of the push [m/s²]."""
    push: str
    """base64 of int8, (n_frames, n_links, 2), in its quanta; empty where it is not known."""


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
        imagined=replay.imagined,
        fps=replay.fps,
        lengthScale=[round(float(length), 4) for length in replay.length_scale],
        parent=[int(parent) for parent in replay.parent],
        parentAttachment=[round(float(place), 4) for place in replay.parent_attachment],
        quantum=quantum,
        first=[int(value) for value in quanta[0].ravel()],
        steps=_base64(steps),
        overlays=[_encode_overlay(overlay) for overlay in replay.overlays],
        pushQuantum=MOST_ACCELERATION / 127,
        push="" if replay.push is None else _base64(_encode_push(replay.push)),
    )


def _encode_overlay(overlay: Overlay) -> EncodedOverlay:
    known = np.isfinite(overlay.values)
    most = float(np.quantile(overlay.values[known], 0.95)) if known.any() else 0.0
    most = max(most, overlay.darkest_at_least, 1e-9)
    levels = np.rint(np.clip(np.where(known, overlay.values, 0.0) / most, 0, 1) * 254)
    return EncodedOverlay(
        label=overlay.label,
        unit=overlay.unit,
        most=float(f"{most:.4g}"),
        levels=_base64(np.where(known, levels, 255).astype(np.uint8)),
    )


def _encode_push(push: npt.NDArray[np.float64]) -> npt.NDArray[np.int8]:
    """Round to quanta; what is too long for them is shortened, its direction kept."""
    size = np.linalg.norm(push, axis=-1, keepdims=True)
    shortened = push * np.minimum(1.0, MOST_ACCELERATION / np.maximum(size, 1e-9))
    return np.asarray(np.rint(shortened * 127 / MOST_ACCELERATION), dtype=np.int8)


def _base64(array: npt.NDArray[np.generic]) -> str:
    return base64.b64encode(array.tobytes()).decode("ascii")
