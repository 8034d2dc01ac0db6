"""Films: an arm's best champion in True Slush, and where it evolved: what it does, and what it promised.

Part of the stages analyse, whose instruments look at the films, and report, which shows them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pipeline.config.settings import RESIDUAL_ENVIRONMENTS
from pipeline.stages import environments
from pipeline.stages.analyses.champions import Champion
from pipeline.stages.environments import SimulationSpec
from pipeline.workflow.stage import Execution, Inputs
from tasks.world import Environment, EnvironmentName

NOBODY = -1
"""The member whose world it is, where it is no member's."""


@dataclass(frozen=True, eq=False)
class Filmed:
    """A rollout of a champion."""

    champion: Champion
    world: EnvironmentName
    """Name of the environment."""
    member: int
    """Whose world it is, or NOBODY's."""
    displacement: float
    """[m]"""
    trace: npt.NDArray[np.float32]
    """(1, n_steps, n_links, 6)"""


def best_of(arm: Sequence[Champion]) -> tuple[int, bool]:
    """Choose the champion to film: the best zero-shot, or where they evolved if none survives True Slush.

    Returns:
        Its index, and whether it survives True Slush.
    """
    scored = [of.zero_shot for of in arm]
    survives = bool(np.isfinite(scored).any())
    return int(np.nanargmax(scored if survives else [of.predicted for of in arm])), survives


def film_arm(
    simulation: SimulationSpec, execution: Execution, arm: Sequence[Champion], networks: Inputs
) -> list[Filmed]:
    """Film the best champion of an arm in True Slush and, if that is elsewhere, where it evolved.

    Args:
        simulation: physics, rollout, and the media of True Slush and of the environment where they evolved.
        execution: the engine.
        arm: its champions; none, no film.
        networks: every member's files by name; where they are missing, worlds made of them are left out.
    """
    if not arm:
        return []
    best, survives = best_of(arm)
    champion, films = arm[best], []
    if survives:
        environment = environments.true_slush(simulation.media, champion.trial.depth)
        rollouts = environments.roll_out(simulation, execution, environment, champion.design, trace=True)
        assert rollouts.trace is not None
        films.append(Filmed(champion, "true_slush", NOBODY, float(rollouts.displacement[0]), rollouts.trace))
    home = champion.trial.environment
    if home != "true_slush" and (networks or home not in RESIDUAL_ENVIRONMENTS):
        films.append(film_at_home(simulation, execution, champion, networks))
    return films


def film_at_home(simulation: SimulationSpec, execution: Execution, champion: Champion, networks: Inputs) -> Filmed:
    """Film a champion where it evolved; of an ensemble, in the world of the member that promises the median."""
    environment, name = home_of(simulation, champion, networks), champion.trial.environment
    rollouts = environments.roll_out(simulation, execution, environment, champion.design, trace=True)
    assert rollouts.trace is not None
    if name not in RESIDUAL_ENVIRONMENTS:
        return Filmed(champion, name, NOBODY, float(rollouts.displacement[0]), rollouts.trace)
    promised = rollouts.displacement[:, 0]
    k = median_member(promised)
    member = own_member(champion, networks) if name == "single_member" else k
    return Filmed(champion, name, member, float(promised[k]), rollouts.trace[k])


def median_member(values: npt.NDArray[np.float64]) -> int:
    """Find the member with the median of (n_members,) values, the lower of two; of those that are finite, if any is."""
    ranked = np.argsort(values, kind="stable")  # those that are not finite last: a rollout that diverged is NaN
    return int(ranked[max(int(np.isfinite(values).sum()) - 1, 0) // 2])


def own_member(champion: Champion, networks: Inputs) -> int:
    """Give the member that a champion of single_member evolved in."""
    return champion.trial.index % len(networks)


def home_of(simulation: SimulationSpec, champion: Champion, networks: Inputs) -> Environment:
    """Give the world that a champion evolved in: of single_member, its own member's."""
    members, trial = list(networks), champion.trial
    if trial.environment == "single_member":
        members = [members[own_member(champion, networks)]]
    own = {name: networks[name] for name in members}
    return environments.build_environment(simulation.media, trial.environment, trial.depth, own)
