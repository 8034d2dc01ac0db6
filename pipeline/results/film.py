"""A film of a design in an environment, for scripts and notebooks."""

from pathlib import Path

from pipeline.errors import PuddleError
from pipeline.report.films import RENDERERS
from pipeline.report.replay import replay_of, shown_trace
from pipeline.store import disk
from tasks.design import Designs
from tasks.simulation import OK, simulate
from tasks.simulation.engine import EngineName
from tasks.world import Environment, Medium, Physics, ResidualSlush, as_environment


def film(
    design: Designs,
    environment: Environment | Medium | str,
    path: str | Path,
    *,
    depth: float | None = None,
    n_settle: int = 200,
    n_measure: int = 1200,
    physics: Physics | None = None,
    engine: EngineName = "batch",
) -> None:
    """Write a film of one design, after it has settled; in an ensemble that of the median member.

    >>> design = puddle.random_designs(1, np.random.default_rng(seed=1))
    >>> puddle.film(design, puddle.TrueSlush(depth=9.0), "robot.gif", n_measure=60)

    Args:
        design: a single design.
        environment: such as ``TrueSlush(depth=9.0)``, or a medium of your own or the name of one, which is 9 m deep.
        path: file that ends in .mp4 or .gif; it is replaced.
        depth: another depth of such a medium [m].
        n_settle: steps before the film begins.
        n_measure: steps of the film, 60 a second.
        physics: constants of the simulator; the paper's by default.
        engine: such as ``mujoco``, another simulator.

    Raises:
        PuddleError: there is not one design, the file has another ending, or the rollout diverged.
    """
    path, environment = Path(path), as_environment(environment, depth)
    if len(design) != 1:
        raise PuddleError(f"{path}: expected one design, got {len(design)}: choose one, such as designs[0]")
    if n_measure < 3:
        raise PuddleError(f"{path}: n_measure: expected at least 3, got {n_measure}")
    if path.suffix not in RENDERERS:
        raise PuddleError(f"{path}: expected a file that ends in {' or '.join(RENDERERS)}, got {path.name}")
    physics = physics or Physics()
    rollouts = simulate(
        design, environment, n_settle=n_settle, n_measure=n_measure, engine=engine, trace=True, physics=physics
    )
    if not (rollouts.status == OK).all():
        raise PuddleError(f"{path}: the rollout diverged: a state is not finite, so there is nothing to show")
    replay = replay_of(
        design,
        shown_trace(rollouts, environment)[0],
        environment,
        title=path.stem,
        seen_in="air" if environment.medium is None else type(environment.medium).__name__,
        n_settle=n_settle,
        hallucinated=isinstance(environment, ResidualSlush),
        physics=physics,
    )
    disk.write(path, RENDERERS[path.suffix]([replay]))
