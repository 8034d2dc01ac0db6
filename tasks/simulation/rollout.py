"""A rollout: one design in one environment, from its spawn to the measured displacement.

Paper, "Performance Evaluation": a robot settles for a while, then the displacement of its root is measured. Motors run
from the first step.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from tasks.arrays import ArrayData, Float32, Float64, Int64
from tasks.design.genes import Designs, check
from tasks.simulation.box2d import Column, Motion
from tasks.simulation.engine import EngineName, engine_in, engine_named
from tasks.world import Environment, Medium, Physics, as_environment
from tasks.world.residual_slush import at_time_step

OK, DIVERGED = "ok", "diverged"


@dataclass(frozen=True, eq=False, repr=False)
class Rollouts(ArrayData):
    """Results of n_designs designs; in an ensemble every array has a leading axis of n_members."""

    displacement: Float64  # (n_designs,) of the root along x, from the end of settling on [m]; NaN where diverged
    com_displacement: Float64  # (n_designs,) the same of the whole robot's centre of mass [m]; NaN where diverged
    second_half_speed: Float64  # (n_designs,) mean speed of the root along x over the second half [m/s]; NaN likewise
    status: npt.NDArray[np.str_]  # (n_designs,) "ok", or "diverged" where a state became non-finite
    trace: Float32 | None
    """(n_designs, n_steps, n_links, 6) x, y [m], angle [rad], vx, vy [m/s], omega [rad/s] after each step, links in the
    design's own order. NaN from the step in which a rollout diverged, and of links that a design lacks; None unless
    requested."""
    motor_torque: Float32 | None = None
    """(n_designs, n_steps, n_links) torque of each joint's motor on the child link [N·m]; NaN like the trace. Only the
    reference engine reports it, together with the trace."""
    motor_work: Float64 | None = None
    """(n_designs,) work of all motors after settling [J], braking included: the sum over steps and joints of
    |torque · speed of the joint| · dt, for each joint exactly as :class:`tasks.simulation.box2d.Motion` says, and then
    summed over the joints in float64. NaN where diverged; None unless requested."""
    n_settle: int = 0  # steps of the trace before displacement is measured

    def __repr__(self) -> str:
        ok = self.displacement[self.status == OK]
        moved = f": displacement {ok.min():.2f} to {ok.max():.2f} m" if ok.size else ""
        return f"{super().__repr__()}{moved}; {self.status.size - ok.size} diverged"


def simulate(
    designs: Designs,
    environment: Environment | Medium | str,
    *,
    depth: float | None = None,
    n_settle: int = 200,
    n_measure: int = 1200,
    engine: EngineName = "batch",
    trace: bool = False,
    motor_work: bool = False,
    physics: Physics | None = None,
) -> Rollouts:
    """Simulate designs, each alone in its own environment (in an ensemble, once for each member).

    >>> designs = puddle.random_designs(64, np.random.default_rng(seed=1))
    >>> puddle.simulate(designs, puddle.TrueSlush(depth=9.0)).displacement.shape  # [m]
    (64,)
    >>> puddle.simulate(designs[:1], "dry_land", n_measure=60, trace=True).trace.shape  # designs, steps, links, state
    (1, 260, 6, 6)

    Args:
        designs: n_designs designs.
        environment: depth and medium, or a medium of your own or the name of one, which is 9 m deep.
        depth: another depth of such a medium [m].
        n_settle: steps before the displacement is measured.
        n_measure: steps over which it is measured.
        engine: ``batch`` or ``reference``, which are Box2D and make way for the engine of a medium that has one of its
            own; ``mujoco``, for any medium.
        trace: whether to record the state after every step.
        motor_work: whether to add up the mechanical work of the motors.
        physics: constants of the simulator; the paper's by default.

    Returns:
        Displacement and status of each design, and what was requested beside them.

    Raises:
        tasks.design.DesignError: a design is out of bounds.
        TypeError: designs or environment are something else.
        ValueError: an argument is out of range.
    """
    environment, physics = as_environment(environment, depth), Physics() if physics is None else physics
    for argument, given, kind in (("designs", designs, Designs), ("physics", physics, Physics)):
        if not isinstance(given, kind):
            raise TypeError(f"{argument}: expected {kind.__name__}, got {type(given).__name__}")
    check(designs)
    environment = at_time_step(environment, physics.time_step)
    for name, value, least in (("n_settle", n_settle, 0), ("n_measure", n_measure, 1)):
        if not isinstance(value, int | np.integer) or value < least:
            raise ValueError(f"{name} is {value!r}, expected at least {least}, a whole number")
    name = engine_in(environment.medium, engine)
    chosen = engine_named("reference" if physics.continuous_collision and name == "batch" else name)
    duration = {"n_settle": n_settle, "n_measure": n_measure}
    second_half_seconds = (n_measure - n_measure // 2) * physics.time_step
    groups, found = designs.by_number_of_links(), []
    for _, alike in groups:
        motion = chosen.roll_out(alike, environment, physics, **duration, trace=trace, motor_work=motor_work)
        found.append(_measure(motion, second_half_seconds, squeeze=not environment.is_ensemble))
    joined = found[0] if len(groups) == 1 else _joined(found, [which for which, _ in groups])
    return replace(joined, n_settle=n_settle)


def _joined(found: Sequence[Rollouts], indices: Sequence[Int64]) -> Rollouts:
    """Join rollouts of some designs each, given the indices of these; what a robot lacks of links is NaN."""
    order, axis = np.argsort(np.concatenate(indices)), found[0].displacement.ndim - 1

    def join(name: str, axis_of_links: int = 0) -> Any:
        arrays = [getattr(part, name) for part in found]
        if arrays[0] is None:
            return None
        if axis_of_links:
            most, beyond = max(array.shape[axis_of_links] for array in arrays), np.zeros((arrays[0].ndim, 2), int)
            for number, array in enumerate(arrays):
                beyond[axis_of_links, 1] = most - array.shape[axis_of_links]
                arrays[number] = np.pad(array, beyond, constant_values=np.nan)
        return np.concatenate(arrays, axis=axis).take(order, axis=axis)

    on_links = {"trace": -2, "motor_torque": -1}
    names = (field.name for field in fields(Rollouts) if field.name != "n_settle")
    return Rollouts(**{name: join(name, on_links.get(name, 0)) for name in names})


def _measure(motion: Motion, second_half_seconds: float, *, squeeze: bool) -> Rollouts:
    """Turn the states at three instants into displacements and speeds."""
    finite = np.asarray(np.isfinite(motion.final).all(axis=(2, 3)))
    x_settled, x_halfway, x_final = (
        states[..., Column.X].astype(np.float64) for states in (motion.settled, motion.halfway, motion.final)
    )
    moved = np.where(finite[..., None], x_final - x_settled, np.nan)
    root = moved[..., 0]
    whole = moved.mean(axis=2)  # every link has the same mass
    speed = np.where(finite, x_final[..., 0] - x_halfway[..., 0], np.nan) / second_half_seconds
    status: npt.NDArray[np.str_] = np.where(finite, OK, DIVERGED)
    work = None
    if motion.motor_work is not None:
        work = np.where(finite, motion.motor_work.astype(np.float64).sum(axis=2), np.nan)
    measured = (root, whole, speed, status, motion.trace, motion.motor_torque, work)
    return Rollouts(*(None if array is None else array[0] for array in measured) if squeeze else measured)
