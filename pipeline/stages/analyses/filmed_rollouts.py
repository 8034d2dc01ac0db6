"""Filmed rollouts: the best champion of an arm in True Slush, and in the environment where it evolved.

Used by the stages analyse, whose instruments measure the films, and report, which shows them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.config.settings import RESIDUAL_ENVIRONMENTS
from pipeline.stages import environments
from pipeline.stages.analyses.champions import Champion
from pipeline.stages.data_sets import own_network
from pipeline.stages.environments import SimulationSpec
from pipeline.workflow.stage import Execution, Inputs
from tasks.arrays import Float32, Float64
from tasks.world import ENVIRONMENTS, Environment, EnvironmentName

NO_MEMBER = -1  # stands for the member in an environment without an ensemble


@dataclass(frozen=True, eq=False)
class Filmed:
    """A rollout of a champion."""

    champion: Champion
    seen_in: EnvironmentName  # environment of the rollout
    member: int  # member of the ensemble, or NO_MEMBER
    displacement: float  # [m]
    trace: Float32  # (1, n_steps, n_links, 6)


def best_of(arm: Sequence[Champion]) -> tuple[int, bool]:
    """Return the index of the champion to film, and whether it survives True Slush.

    It is the best zero-shot, or the best where it evolved if none survives.
    """
    scored = [champion.zero_shot for champion in arm]
    survives = bool(np.isfinite(scored).any())
    return int(np.nanargmax(scored if survives else [champion.fitness for champion in arm])), survives


def film_arm(
    simulation: SimulationSpec, execution: Execution, arm: Sequence[Champion], networks: Inputs
) -> list[Filmed]:
    """Return films of an arm's best champion: in True Slush and, if it evolved elsewhere, where it evolved.

    Args:
        simulation: physics, rollout, and the media of True Slush and of the environment where they evolved.
        execution: the engine.
        arm: champions of the arm.
        networks: files of every member; if they are missing, environments with networks are left out.
    """
    if not arm:
        return []
    best, survives = best_of(arm)
    champion, films = arm[best], []
    if survives:
        environment = environments.true_slush(simulation.media, champion.trial.depth)
        rollouts = environments.roll_out(simulation, execution, environment, champion.design, trace=True)
        assert rollouts.trace is not None
        films.append(Filmed(champion, "true_slush", NO_MEMBER, float(rollouts.displacement[0]), rollouts.trace))
    home = champion.trial.environment
    if home != "true_slush" and (networks or home not in RESIDUAL_ENVIRONMENTS):
        films.append(_film_at_home(simulation, execution, champion, networks))
    return films


def _film_at_home(simulation: SimulationSpec, execution: Execution, champion: Champion, networks: Inputs) -> Filmed:
    """Film a champion where it evolved; for an ensemble, under the member whose prediction is the median."""
    environment, name = home_of(simulation, champion, networks), champion.trial.environment
    rollouts = environments.roll_out(simulation, execution, environment, champion.design, trace=True)
    assert rollouts.trace is not None
    if not environment.is_ensemble:
        return Filmed(champion, name, NO_MEMBER, float(rollouts.displacement[0]), rollouts.trace)
    predicted = rollouts.displacement[:, 0]
    k = median_member(predicted)
    member = own_network(champion.trial) if ENVIRONMENTS[name].networks == "one" else k
    return Filmed(champion, name, member, float(predicted[k]), rollouts.trace[k])


def median_member(values: Float64) -> int:
    """Return the member with the median of (n_members,) values, the lower of two; non-finite values are ignored."""
    ranked = np.argsort(values, kind="stable")  # NaN, for a rollout that diverged, comes last
    return int(ranked[max(int(np.isfinite(values).sum()) - 1, 0) // 2])


def home_of(simulation: SimulationSpec, champion: Champion, networks: Inputs) -> Environment:
    """Return the environment in which a champion evolved.

    Args:
        simulation: the media.
        champion: the champion.
        networks: files of every network.
    """
    trial = champion.trial
    own = environments.home_networks_among(networks, trial)
    return environments.build_environment(simulation.media, trial.environment, trial.depth, own)
