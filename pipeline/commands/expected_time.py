"""About how long the stages of a study take, for the time left that `puddle study` shows.

The figures are for one core of an AMD EPYC (docs/performance.md) and need no measurement. They are right within a
factor of two or three, and corrected by how long the stages really take. Kernels that this machine has not compiled yet
are included. `puddle forecast` measures instead.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

from pipeline.config.settings import Settings
from pipeline.stages import STAGES, environments
from pipeline.stages.segments import TrialSpec
from pipeline.workflow.stage import Chain
from tasks.simulation.batch import seconds_to_compile
from tasks.world import ENVIRONMENTS, EnvironmentName

_STEPS_OF_DESIGNED_THROW = 30  # where the settings leave them to the range of robots' speeds
_LINKS = 6
_SECONDS_PER_STEP = {"batch": 0.1e-6, "rigid": 0.8e-6, "reference": 15e-6}  # of one robot without networks
_SECONDS_PER_MEMBER_STEP = 0.2e-6  # of one robot under one network, besides the network's arithmetic
_FLOPS_OF_INFERENCE = 190e9  # per second
_FLOPS_OF_TRAINING = 30e9  # per second
_PASSES_OF_TRAINING = 3  # forward, and twice as much backward
_SECONDS_PER_ITERATION = 0.3e-3  # of training, besides arithmetic
_SECONDS_PER_THROW_STEP = 0.1e-6
_SECONDS_PER_PICTURE = 4.4e-3
_SECONDS_PER_ITEM = {"collect": 1.0, "train": 4.0, "analyse": 0.5}  # to import torch and the like; else as below
_SECONDS_PER_OTHER_ITEM = 0.02


def expected_seconds(settings: Settings, n_cores: float) -> dict[str, float]:
    """Return about how long each stage of a study takes, from its beginning to its end, by name [s].

    Args:
        settings: the study's settings.
        n_cores: number of cores that compute it.
    """
    found = {}
    for stage in STAGES:
        per_unit = _PER_UNIT[stage.name]
        fixed = _SECONDS_PER_ITEM.get(stage.name, _SECONDS_PER_OTHER_ITEM)
        core_seconds, longest = 0.0, 0.0  # no number of cores gets below the longest chain
        for chain in stage.plan(settings):
            seconds = chain.n_items * fixed + sum(chain.units) * per_unit(settings, chain)
            core_seconds += seconds
            longest = max(longest, seconds / batches_per_generation(settings, chain))
        found[stage.name] = max(core_seconds / max(n_cores, 1.0), longest)
    found["evolve"] += seconds_to_compile(settings.physics)  # its workers wait for most kernels
    return found


def batches_per_generation(settings: Settings, chain: Chain[Any]) -> int:
    """Return how many workers compute a generation of a trial at the same time; 1 for other chains."""
    if not isinstance(chain.spec, TrialSpec):
        return 1
    size = environments.execution_options(settings, chain.spec.environment).designs_per_batch
    return math.ceil(settings.evolution.afpo.population_size / size) if size else 1


def _rollout(settings: Settings, environment: EnvironmentName) -> float:
    """Return the time of one rollout of one robot [s]."""
    n_steps = settings.rollout.n_settle + settings.rollout.n_measure
    n_members = environments.number_of_members(settings, environment)
    engine: str = settings.work.engine
    if engine == "batch" and (settings.physics.link_collisions or settings.physics.passive_joints == "locked"):
        engine = "rigid"
    if ENVIRONMENTS[environment].networks == "none":
        return n_steps * n_members * _SECONDS_PER_STEP[engine]
    physics = max(_SECONDS_PER_MEMBER_STEP, _SECONDS_PER_STEP[engine])
    return n_steps * n_members * (physics + _LINKS * environments.network_flops(settings) / _FLOPS_OF_INFERENCE)


def _iteration(settings: Settings) -> float:
    """Return the time of one iteration of training one network [s]."""
    flops = _PASSES_OF_TRAINING * settings.training.batch_size * environments.network_flops(settings)
    return _SECONDS_PER_ITERATION + flops / _FLOPS_OF_TRAINING


def _generation(settings: Settings, chain: Chain[Any]) -> float:
    """Return the time of one generation of a trial [s]."""
    return _rollouts(settings, chain.spec.environment)


def _rollouts(settings: Settings, environment: EnvironmentName) -> float:
    return settings.evolution.afpo.population_size * _rollout(settings, environment)


_PER_UNIT: Mapping[str, Callable[[Settings, Chain[Any]], float]] = {
    "collect": lambda settings, chain: (
        (getattr(chain.spec, "throws", settings.throws).n_steps or _STEPS_OF_DESIGNED_THROW) * _SECONDS_PER_THROW_STEP
    ),
    "train": lambda settings, chain: _iteration(settings),
    "pilot": lambda settings, chain: chain.spec.n_generations * _rollouts(settings, "residual_slush"),
    "evolve": _generation,
    "transfer": _generation,
    "assess": lambda settings, chain: _rollout(settings, "true_slush") + _rollout(settings, "residual_slush"),
    "analyse": lambda settings, chain: chain.weight * _rollout(settings, "dry_land"),
    "report": lambda settings, chain: _SECONDS_PER_PICTURE,
}
