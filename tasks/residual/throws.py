"""The data set: links thrown into slush, and the base simulator's residual in each step. Paper, "Dataset Collection".

Throws have no ground, so one data set serves every depth. A throw depends on its start only, not on the chunk of throws
that it was computed with.

The paper's throws start at up to 28 m/s and 20 rad/s, stop within a few steps, and then drift. Robots move at a few
metres per second and turn slowly. Throws that are designed for robots cover the states of robots' links evenly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from tasks.arrays import ArrayData, Bools, Float32, Float64, Int64
from tasks.parameters import Parameters
from tasks.residual.robot_ranges import robot_ranges
from tasks.seeding import generator
from tasks.simulation.engine import links_in
from tasks.simulation.free_links import FreeLinks, link_constants
from tasks.world import Environment, LinkStates, Medium, Physics, as_environment
from tasks.world.medium import MediumError, MediumWithMemory

STATE = ("x", "y", "angle", "vx", "vy", "omega")  # of a link; also of a step's residual [m, m, rad, m/s, m/s, rad/s]

_FLOOR = 0.1  # share of the residuals' deviation below which their uncertainty does not matter
_STRUCK = 0.2  # share of the steps in which a bar is struck
_X_REACH = 0.2  # initial x lies within ± this [m]; paper


class Throws(Parameters):
    """Settings of the throws."""

    source: Literal["simulation", "tracks"] = "simulation"
    """Where throws come from: simulated in the true medium, or tracked, of real bars, as the settings group tracks
    says. With tracks, nothing else of this group is used, and n_throws is that of the file."""
    n_throws: int = Field(default=500, ge=2, le=1_000_000)
    """Number of throws. [P]"""
    n_steps: int | None = Field(default=200, ge=1, le=100_000)
    """Steps of each throw; the default is 3.3 s [P]. null: in throws for robots, as many as gravity takes to accelerate
    a link beyond the range of their speeds, about half a second."""
    design: Literal["paper", "robots", "struck"] = "paper"
    """Starts: "paper" draws them uniformly within the ranges below [P]. "robots" spreads them evenly, as a scrambled
    Sobol sequence, over the states that links of random designs pass through in the base simulator, and ignores the
    ranges below. "struck" strikes these bars, too, in one of five steps, as hard as joints and motors do: a fluid that
    is accelerated with a link answers such kicks, which networks of the form wetted_mass learn."""
    length_scales: tuple[Annotated[float, Field(ge=0.1, le=10.0)], ...] = Field(default=(1.0, 2.0, 3.0), min_length=1)
    """Long axes of links, drawn with equal probability [m]. [P]"""
    y_reach: float = Field(default=6.0, ge=0.0, le=1000.0)
    """Initial y lies within ± this [m], above and in the slush. [P]"""
    max_velocity: float = Field(default=20.0, ge=0.0, le=80.0)
    """Initial vx and vy lie within ± this [m/s]. [P] Box2D limits motion to 2 m per step."""
    max_omega: float = Field(default=20.0, ge=0.0, le=90.0)
    """Initial ω lies within ± this [rad/s]. [P] Box2D limits rotation to π/2 per step."""

    @model_validator(mode="after")
    def _ranges_are_used(self) -> Self:
        if self.design != "paper":
            ranges = ("length_scales", "y_reach", "max_velocity", "max_omega")
            changed = [name for name in ranges if getattr(self, name) != type(self).model_fields[name].default]
            if changed:
                raise ValueError(
                    f"design is {self.design}, which ignores {', '.join(changed)}: expected the design paper"
                )
        elif self.n_steps is None:
            raise ValueError("n_steps is null, which only the design robots decides: expected at least 1")
        return self

    def n_steps_of(self, physics: Physics) -> int:
        """Return the number of steps of each throw."""
        return robot_ranges(physics).n_steps if self.n_steps is None else self.n_steps


DESIGNED_THROWS = Throws(design="robots", n_throws=3400, n_steps=None)
"""Throws that are designed for robots: of 29 steps each, they are 98,600 transitions, about as many as the paper's."""


@dataclass(frozen=True, eq=False, repr=False)
class Starts(ArrayData):
    """Initial states of throws; axis 0 is the throw."""

    throw: Int64  # (n_throws,) index of the throw in the data set
    length_scale: Float64  # (n_throws,) long axis [m]
    state: Float32  # (n_throws, 6) initial state in the order of STATE
    kick: Float32 = field(default_factory=lambda: np.zeros((1, 0, 3), np.float32))
    """(n_throws, n_steps, 3) what strikes change of vx, vy and ω before each step; of no step by default."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "kick", np.broadcast_to(self.kick, (len(self), *self.kick.shape[1:])))

    def __len__(self) -> int:
        return len(self.throw)

    def __getitem__(self, chunk: slice) -> Starts:
        """Return a chunk of the throws."""
        return Starts(*(getattr(self, of.name)[chunk] for of in fields(self)))


@dataclass(frozen=True, eq=False, repr=False)
class Transitions(ArrayData):
    """One step from each state of the throws, in E and in E'; axis 0 is the transition."""

    throw: Int64  # (n_transitions,) index of the throw in the data set
    step: Int64  # (n_transitions,) steps since the start
    length_scale: Float64  # (n_transitions,) long axis [m]
    state: Float32  # (n_transitions, 6) state before both steps, in the order of STATE
    next_in_target: Float32  # (n_transitions, 6) state after a step of E, of the medium thrown into
    next_on_dry_land: Float32  # (n_transitions, 6) state after a step of E'
    residual: Float32  # (n_transitions, 6) residual e = E(x) - E'(x), in the order of STATE
    kick: Float32 = field(default_factory=lambda: np.zeros((1, 3), np.float32), kw_only=True)
    """(n_transitions, 3) what strikes changed of vx, vy and ω just before; nothing by default."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "kick", np.broadcast_to(self.kick, (len(self.throw), 3)))

    def columns(self) -> dict[str, Any]:
        """Return the arrays by name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def __len__(self) -> int:
        return len(self.throw)

    def links(self, physics: Physics) -> LinkStates:
        """Return the links before the steps, each (n_transitions,)."""
        x, y, angle, vx, vy, omega = self.state.T
        of_links = link_constants(self.length_scale, physics)
        return LinkStates(*of_links, y, np.cos(angle), np.sin(angle), vx, vy, omega, x, *self.kick.T)

    def __getitem__(self, rows: Bools | Int64) -> Self:
        """Select transitions by a mask, or by their numbers."""
        return type(self)(**{name: column[rows] for name, column in self.columns().items()})

    @staticmethod
    def of_states(table: Any, physics: Physics | None = None) -> Transitions:
        """Make transitions of a table of states, as :func:`tasks.residual.training.learn` takes it."""
        names = ("throw", "length_scale", *STATE)
        try:
            throw, length_scale, *columns = (np.asarray(table[name]) for name in names)
        except KeyError as missing:
            raise ValueError(f"throws: expected a table with columns {', '.join(names)}; it has no {missing}") from None
        if not (length_scale > 0).all():
            raise ValueError(f"throws: length_scale is {length_scale.min():g} m, expected more than 0")
        state, number = np.stack(columns, axis=1).astype(np.float32), np.arange(len(throw))
        goes_on = np.append(False, throw[1:] == throw[:-1])
        step = number - np.maximum.accumulate(np.where(goes_on, 0, number))
        now = np.flatnonzero(goes_on) - 1
        on_dry_land = FreeLinks(length_scale[now], physics or Physics()).step(state[now], None)
        return _transitions(throw[now], step[now], length_scale[now], state[now], state[now + 1], on_dry_land)

    @classmethod
    def concatenate(cls, chunks: Sequence[Self]) -> Self:
        """Concatenate chunks in the given order."""
        columns = [chunk.columns() for chunk in chunks]
        return cls(**{name: np.concatenate([part[name] for part in columns]) for name in columns[0]})

    @classmethod
    def of_several(cls, data_sets: Sequence[Self]) -> Self:
        """Join one or more data sets of different throws, which are numbered anew, from 0."""
        if not data_sets:
            raise ValueError("throws: expected at least one data set, got none")
        numbers = [np.unique(data_set.throw, return_inverse=True)[1] for data_set in data_sets]
        first = np.cumsum([0, *(number.max(initial=-1) + 1 for number in numbers)])
        numbered = zip(data_sets, numbers, first[:-1], strict=True)
        return cls.concatenate([replace(data_set, throw=number + start) for data_set, number, start in numbered])


@dataclass(frozen=True, eq=False, repr=False)
class MeasuredTransitions(Transitions):
    """Transitions of real throws, whose residuals are uncertain."""

    residual_sd: Float32  # (n_transitions, 6) deviation of the residual
    held_out: Bools  # (n_transitions,) of throws that the medium of the further throws was not fitted to


def initial_states(throws: Throws, rng: np.random.Generator, physics: Physics | None = None) -> Starts:
    """Draw the starts of all throws; those for robots cover the states of robots in the base simulator of physics."""
    n = throws.n_throws
    if throws.design != "paper":
        physics = physics or Physics()
        starts = even_starts(n, physics, rng)
        n_struck = throws.n_steps_of(physics) if throws.design == "struck" else 0
        return replace(starts, kick=_kicks(n, n_struck, physics, rng))
    reach = np.array((_X_REACH, throws.y_reach, np.pi, *[throws.max_velocity] * 2, throws.max_omega))
    length_scale = rng.choice(np.array(throws.length_scales), size=n)
    state = rng.uniform(-1.0, 1.0, size=(n, len(STATE))) * reach
    state[:, STATE.index("angle")] += np.pi  # 0 to 2π
    return Starts(np.arange(n), length_scale, state.astype(np.float32))


def _kicks(n: int, n_steps: int, physics: Physics, rng: np.random.Generator) -> Float32:
    """Strike each of n bars in a share of n_steps steps, but not at once."""
    ranges = robot_ranges(physics)
    kick = rng.uniform(-1, 1, (n, n_steps, 3)) * (ranges.max_kick, ranges.max_kick, ranges.max_kick_omega)
    kick *= rng.random((n, n_steps, 1)) < _STRUCK
    kick[:, :1] = 0.0
    return kick.astype(np.float32)


def even_starts(
    n: int, physics: Physics, rng: np.random.Generator, *, heights: tuple[float, float] | None = None
) -> Starts:
    """Spread n starts evenly over the length, height, angle, velocities and spin of robots' links.

    ``heights`` are the least and the greatest of the centre [m], by default those of the ranges.
    """
    from scipy.stats import qmc  # takes long to import, and settings files are read without it

    ranges = robot_ranges(physics)
    v, omega = (-ranges.max_velocity, ranges.max_velocity), (-ranges.max_omega, ranges.max_omega)
    heights = heights or (-ranges.y_reach, ranges.y_reach)
    low, high = np.transpose([ranges.length_scale, heights, (0, 2 * np.pi), v, v, omega])
    sequence = qmc.Sobol(len(low), scramble=True, rng=rng)
    even = sequence.random_base2(max(n - 1, 0).bit_length())[:n]  # whole powers of 2 are balanced
    length_scale, *rest = (low + (high - low) * even).T
    return Starts(np.arange(n), length_scale, np.stack((np.zeros(n), *rest), axis=1).astype(np.float32))


def simulate_throws(starts: Starts, n_steps: int, medium: Medium | MediumWithMemory, physics: Physics) -> Transitions:
    """Return (len(starts) · n_steps) transitions, ordered by throw and step: a step in E and one in E' from each state.

    Args:
        starts: initial states of all throws, or of a chunk.
        n_steps: number of steps of each throw.
        medium: the medium of E; E' has none.
        physics: the base simulator's constants.

    Raises:
        MediumError: the medium gives changes that are not finite.
    """
    in_target, dry = links_in(medium, starts.length_scale, physics), FreeLinks(starts.length_scale, physics)
    n, struck = len(starts), starts.kick.shape[1] == n_steps
    state, in_slush, on_dry_land = np.empty((3, n, n_steps, len(STATE)), dtype=np.float32)
    now = starts.state
    for step in range(n_steps):
        state[:, step] = now
        if struck:
            state[:, step, 3:] += starts.kick[:, step]
            now = state[:, step]
        on_dry_land[:, step] = dry.step(now, None)
        now = in_target(now)
        in_slush[:, step] = now
    if not np.isfinite(in_slush).all():
        k, step, _ = np.argwhere(~np.isfinite(in_slush))[0]
        name, where = type(medium).__name__, f"step {step} of throw {starts.throw[k]}"
        raise MediumError(f"{name}: expected finite states, got {in_slush[k, step]} ({', '.join(STATE)}) after {where}")

    x, E, E_dry = (states.reshape(-1, len(STATE)) for states in (state, in_slush, on_dry_land))
    length_scale = np.repeat(starts.length_scale, n_steps)
    throw, number = np.repeat(starts.throw, n_steps), np.tile(np.arange(n_steps), n)
    transitions = _transitions(throw, number, length_scale, x, E, E_dry)
    return replace(transitions, kick=starts.kick.reshape(-1, 3)) if struck else transitions


def _transitions(throw: Int64, step: Int64, a: Float64, x: Float32, E: Float32, E_dry: Float32) -> Transitions:
    return Transitions(throw, step, a, x, E, E_dry, residual=E - E_dry)


def throw(
    environment: Environment | Medium | str,
    throws: Throws | None = None,
    *,
    seed: int = 1,
    physics: Physics | None = None,
) -> Transitions:
    """Throw links into a medium as studies do, and record what the base simulator gets wrong in every step.

    >>> throws = puddle.throw("true_slush", puddle.Throws(n_throws=20, n_steps=30))
    >>> throws.residual.shape  # 20 · 30 steps; x, y, angle, vx, vy, omega
    (600, 6)

    Args:
        environment: such as ``TrueSlush(depth=9.0)``, a medium of your own or the name of one. Throws meet no ground.
        throws: number, length and starts of throws; by default 3,400 for robots, of half a second each.
        seed: of the starts.
        physics: constants of the base simulator; the paper's by default.

    Raises:
        ValueError: there is no such environment, or it does not have one medium, or its changes are not finite.
    """
    throws, physics, there = throws or DESIGNED_THROWS, physics or Physics(), as_environment(environment)
    if there.medium is None or there.is_ensemble:
        raise ValueError(f"environment: expected one with one medium, such as true_slush, got {environment!r}")
    starts = initial_states(throws, generator(seed, "collect"), physics)
    return simulate_throws(starts, throws.n_steps_of(physics), there.medium, physics)


def precision_weights(residual: Float32, residual_sd: Float32) -> Float32:
    """Return the weights of uncertain residuals: inverse variances, 1 at most.

    The weight is f² / (f² + sd²). The floor f is a tenth of the residuals' deviation, far below what networks of a
    study get wrong: that a residual is known better than so earns it no more weight.
    """
    floor = np.maximum(_FLOOR * residual.std(axis=0, dtype=np.float64), np.finfo(np.float32).tiny)
    weights: Float32 = (1 / (1 + np.square(residual_sd / floor))).astype(np.float32)
    return weights
