"""The data set: links thrown into slush, and what one step of the base simulator misses. Paper, "Dataset Collection".

There is no ground in the throws' world, so one data set serves every depth. A throw's numbers depend on its start
alone, not on the chunk of throws it was computed with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from tasks.arrays import Float32, Float64, Int64
from tasks.parameters import Parameters
from tasks.residual.observation import STATE, observe
from tasks.simulation.free_links import FreeLinks
from tasks.world import Medium, Physics


class Throws(Parameters):
    """What is thrown, and how."""

    n_throws: int = Field(default=500, ge=2, le=1_000_000)
    """[P]"""
    n_steps: int = Field(default=200, ge=1, le=100_000)
    """Steps of each throw: 3.3 s. [P]"""
    length_scales: tuple[Annotated[float, Field(ge=0.1, le=10.0)], ...] = Field(default=(1.0, 2.0, 3.0), min_length=1)
    """Long axes that links are drawn from [m]. [P]"""
    x_reach: float = Field(default=0.2, ge=0.0, le=1000.0)
    """x starts within ± this [m]. [P]"""
    y_reach: float = Field(default=6.0, ge=0.0, le=1000.0)
    """y starts within ± this [m]: above and in the slush. [P]"""
    max_velocity: float = Field(default=20.0, ge=0.0, le=80.0)
    """vx and vy start within ± this [m/s]. [P] Box2D moves nothing by more than 2 m a step."""
    max_omega: float = Field(default=20.0, ge=0.0, le=90.0)
    """ω starts within ± this [rad/s]. [P] Box2D turns nothing by more than π/2 a step."""
    throw_speed: Literal["uniform", "log_uniform"] = "uniform"
    """Velocities as drawn [P]; or all three of a throw times 10^U(-2, 0), for more of the low speeds robots live at."""


@dataclass(frozen=True, eq=False)
class Starts:
    """Where throws begin; axis 0 is the throw."""

    throw: Int64
    """(n_throws,) which throw of the data set."""
    length_scale: Float64
    """(n_throws,) long axis [m]."""
    state: Float32
    """(n_throws, 6) in the order of STATE."""

    def __len__(self) -> int:
        return len(self.throw)

    def __getitem__(self, chunk: slice) -> Starts:
        """Take a chunk of the throws."""
        return Starts(self.throw[chunk], self.length_scale[chunk], self.state[chunk])


@dataclass(frozen=True, eq=False)
class Transitions:
    """One step from each state that throws pass through, in E and in E'; axis 0 is the transition."""

    throw: Int64
    """(n_transitions,)"""
    step: Int64
    """(n_transitions,) steps since the start."""
    length_scale: Float64
    """(n_transitions,) long axis [m]."""
    state: Float32
    """(n_transitions, 6) in the order of STATE: where both steps begin."""
    next_in_slush: Float32
    """(n_transitions, 6) after a step of E."""
    next_on_dry_land: Float32
    """(n_transitions, 6) after a step of E'."""
    observation: Float32
    """(n_transitions, 6) in the order of OBSERVATION: what a network reads of the state."""
    residual: Float32
    """(n_transitions, 6) e = E(x) - E'(x), in the order of STATE."""

    def __len__(self) -> int:
        return len(self.throw)

    def __getitem__(self, rows: npt.NDArray[np.bool_]) -> Transitions:
        """Choose transitions by a mask."""
        return Transitions(*(getattr(self, f.name)[rows] for f in fields(Transitions)))

    @staticmethod
    def concatenate(chunks: Sequence[Transitions]) -> Transitions:
        """Join chunks in the order given."""
        return Transitions(*(np.concatenate([getattr(c, f.name) for c in chunks]) for f in fields(Transitions)))


def initial_states(throws: Throws, rng: np.random.Generator) -> Starts:
    """Draw the starts of all throws, each uniform within its range."""
    n = throws.n_throws
    reach = np.array((throws.x_reach, throws.y_reach, np.pi, *[throws.max_velocity] * 2, throws.max_omega))
    length_scale = rng.choice(np.array(throws.length_scales), size=n)
    state = rng.uniform(-1.0, 1.0, size=(n, len(STATE))) * reach
    state[:, STATE.index("angle")] += np.pi  # 0 to 2π
    if throws.throw_speed == "log_uniform":
        state[:, 3:] *= 10 ** rng.uniform(-2.0, 0.0, size=(n, 1))
    return Starts(np.arange(n), length_scale, state.astype(np.float32))


def simulate_throws(starts: Starts, n_steps: int, medium: Medium, physics: Physics) -> Transitions:
    """Follow throws through E, and take one step of E' beside each step of E, from the same state.

    Args:
        starts: the throws, or a chunk of them.
        n_steps: steps of each throw.
        medium: what E has and E' lacks.
        physics: the base simulator that both share.

    Returns:
        (len(starts) * n_steps) transitions, throw by throw and step by step.
    """
    links = FreeLinks(starts.length_scale, physics)
    n = len(starts)
    state, in_slush, on_dry_land = np.empty((3, n, n_steps, len(STATE)), dtype=np.float32)
    now = starts.state
    for step in range(n_steps):
        state[:, step] = now
        on_dry_land[:, step] = links.step(now, None)
        now = links.step(now, medium)
        in_slush[:, step] = now

    x = state.reshape(-1, len(STATE))
    E = in_slush.reshape(x.shape)
    E_dry = on_dry_land.reshape(x.shape)
    length_scale = np.repeat(starts.length_scale, n_steps)
    _, y, angle, vx, vy, omega = x.T
    return Transitions(
        throw=np.repeat(starts.throw, n_steps),
        step=np.tile(np.arange(n_steps), n),
        length_scale=length_scale,
        state=x,
        next_in_slush=E,
        next_on_dry_land=E_dry,
        observation=observe(length_scale=length_scale, y=y, cos=np.cos(angle), vx=vx, vy=vy, omega=omega),
        residual=E - E_dry,
    )
