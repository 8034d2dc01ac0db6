"""Robots as data: what a medium did to their links, recorded as throws are.

Throws show bars alone. Where a medium acts otherwise on links that joints move, the robots that evolved in what was
learned of throws, tried there, show what is missing; :func:`tasks.residual.training.learn` learns from both.
"""

from __future__ import annotations

import numpy as np

from tasks.arrays import Float32, Int64
from tasks.design import Designs
from tasks.residual.throws import Transitions
from tasks.simulation.engine import links_in
from tasks.simulation.free_links import FreeLinks
from tasks.simulation.rollout import Rollouts, simulate
from tasks.world import Environment, LinkStates, Medium, Physics, Pool, VelocityChange, as_environment
from tasks.world.medium import MediumWithMemory, NativeFluid, change_in


class _Recorded:
    """A medium that keeps what it was asked and what it answered."""

    def __init__(self, medium: Medium) -> None:
        self._medium = medium
        self.steps: list[tuple[LinkStates, VelocityChange]] = []

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        change = change_in(self._medium, links, physics)
        self.steps.append((links, change))
        return change


class _Recorder:
    """Media of rollouts, each of them recorded."""

    def __init__(self, medium: Medium | MediumWithMemory) -> None:
        self._medium = medium
        self.rollouts: list[_Recorded] = []

    def start(self, links: LinkStates, physics: Physics, depth: float) -> _Recorded:
        medium = self._medium
        self.rollouts.append(_Recorded(medium.start(links, physics, depth) if hasattr(medium, "start") else medium))
        return self.rollouts[-1]


def record(
    designs: Designs,
    environment: Environment | Medium | str,
    *,
    depth: float | None = None,
    n_settle: int = 200,
    n_measure: int = 1200,
    physics: Physics | None = None,
) -> Transitions:
    """Simulate robots, and record what the medium changed of each link in every step.

    >>> robots = puddle.random_designs(2, np.random.default_rng(seed=1))
    >>> tracks = puddle.record(robots, "falling_plate", n_settle=0, n_measure=30)
    >>> tracks.residual.shape  # 2 robots · 6 links · 30 steps
    (360, 6)

    Args:
        designs: n_designs robots; the links of each are one throw.
        environment: depth and medium, or a medium of your own or the name of one, which is 9 m deep.
        depth: another depth of such a medium [m].
        n_settle: steps of settling, which are recorded, too.
        n_measure: steps after them.
        physics: constants of the base simulator; the paper's by default.

    Returns:
        Transitions ordered by design, link and step, with the kicks of joints, motors and contacts. What a robot does
        after it diverged is left out, and in an engine's own fluid its first step.

    Raises:
        ValueError: there is no such environment, or it does not have one medium.
    """
    physics, there = physics or Physics(), as_environment(environment, depth)
    if there.medium is None or there.is_ensemble:
        raise ValueError(f"environment: expected one with one medium, such as true_slush, got {environment!r}")
    tracks = []
    for which, group in designs.by_number_of_links():
        if isinstance(there.medium, NativeFluid):
            done = simulate(group, there, n_settle=n_settle, n_measure=n_measure, physics=physics, trace=True)
            tracks.append(_stepped_alone(done, group, which, there.medium, physics))
            continue
        recorder = _Recorder(there.medium)
        simulate(group, Pool(there.depth, recorder), n_settle=n_settle, n_measure=n_measure, physics=physics)
        tracks.append(_transitions(recorder.rollouts[0].steps, which, physics))  # the second is to compare with
    return Transitions.concatenate(tracks)


def _stepped_alone(
    done: Rollouts, designs: Designs, numbers: Int64, medium: NativeFluid, physics: Physics
) -> Transitions:
    """Return what an engine's own fluid changes of links in steps as if each were alone; the first step is left out."""
    assert done.trace is not None
    state = done.trace[:, :-1].astype(np.float32).swapaxes(1, 2)  # (n_designs, n_links, n_steps, 6)
    n_designs, n_links, n_steps, _ = state.shape
    a, by_step = designs.length_scale[:, :n_links].ravel(), state.reshape(n_designs * n_links, n_steps, 6)
    finite = np.isfinite(by_step.sum(axis=2))  # MuJoCo steps links together, and would share what is not
    in_fluid, free = links_in(medium, a, physics), FreeLinks(a, physics)
    in_target, on_dry_land = np.empty((2, *by_step.shape), np.float32)
    for k in range(n_steps):
        now = np.where(finite[:, k, None], by_step[:, k], np.float32(0))
        in_target[:, k], on_dry_land[:, k] = in_fluid(now), free.step(now, None)
    kick = np.zeros((n_designs * n_links, n_steps, 3), np.float32)
    kick[:, 1:] = by_step[:, 1:, 3:] - in_target[:, :-1, 3:]
    transitions = Transitions(
        throw=np.repeat(numbers, n_links * n_steps),
        step=np.tile(np.arange(n_steps), n_designs * n_links),
        length_scale=np.repeat(a, n_steps),
        state=by_step.reshape(-1, 6),
        next_in_target=in_target.reshape(-1, 6),
        next_on_dry_land=on_dry_land.reshape(-1, 6),
        residual=(in_target - on_dry_land).reshape(-1, 6),
        kick=kick.reshape(-1, 3),
    )
    kept = finite.ravel() & np.isfinite(transitions.next_in_target).all(axis=1)
    return transitions[np.flatnonzero(kept & np.isfinite(transitions.kick).all(axis=1))]


def _transitions(steps: list[tuple[LinkStates, VelocityChange]], design: Int64, physics: Physics) -> Transitions:
    """Return what was recorded of designs with these numbers."""

    def rows(*names: str, of: int = 0) -> Float32:
        by_step = np.array([[getattr(step[of], name)[0] for name in names] for step in steps], np.float32)
        return by_step.transpose(2, 3, 0, 1).reshape(-1, len(names))  # design, link, step

    x, y, cos, sin, *velocities = rows("x", "y", "cos", "sin", "vx", "vy", "omega").T
    state = np.stack((x, y, np.arctan2(sin, cos), *velocities), axis=1)
    change, (a,) = rows("vx", "vy", "omega", of=1), rows("length_scale").T.astype(np.float64)
    pushed = state.copy()
    pushed[:, 3:] += change
    free = FreeLinks(a, physics)
    in_target, on_dry_land = free.step(pushed, None), free.step(state, None)
    n_steps, n_links = len(steps), steps[0][0].y.shape[-1]
    transitions = Transitions(
        throw=np.repeat(design, n_links * n_steps),
        step=np.tile(np.arange(n_steps), len(design) * n_links),
        length_scale=a,
        state=state,
        next_in_target=in_target,
        next_on_dry_land=on_dry_land,
        residual=in_target - on_dry_land,
        kick=rows("kick_vx", "kick_vy", "kick_omega"),
    )
    return transitions[np.flatnonzero(np.isfinite(in_target).all(axis=1))]
