"""What work takes on a core, by a table, and how many trials to compute together.

A chain's weight is what a unit of its work takes [s]: it decides the order of work, the time left, and a forecast
before the store has measured any. The constants are of one core of an AMD EPYC (docs/performance.md), and right within
a factor of two.
"""

import math

from pipeline.config.settings import Settings
from pipeline.stages.environments import environment_of, media_of
from tasks.residual import Architecture, Throws, Training
from tasks.simulation.batch import n_that_fill_lanes
from tasks.simulation.fluids import is_compiled
from tasks.world import ENVIRONMENTS, EnvironmentName

_STEP = {"batch": 0.2e-6, "rigid": 0.8e-6, "reference": 15e-6}  # of one robot without networks [s]
_STEP_UNDER_NETWORK = 0.35e-6  # of one robot under one network, besides the network's arithmetic [s]
_STEP_IN_OTHER_ENGINE = 200e-6  # of one robot in MuJoCo [s]
_CALL_OF_MEDIUM, _STEP_IN_MEDIUM = 100e-6, 0.5e-6  # in NumPy: of a call, and of one robot [s]
_STEP_OF_THROW = 0.1e-6  # [s]
_STEPS_OF_DESIGNED_THROW = 30  # where the settings leave them to the range of robots' speeds
_ITERATION = 0.15e-3  # of training, besides arithmetic [s]
_FLOPS_OF_INFERENCE, _FLOPS_OF_TRAINING = 190e9, 70e9  # per second
_PASSES_OF_TRAINING = 3  # forward, and twice as much backward


def batch_size(settings: Settings, environment: EnvironmentName) -> int:
    """Return how many trials of an environment fill the engine's lanes together, where one leaves some empty."""
    # An ensemble fills the lanes, and single members differ between trials.
    if settings.work.engine != "batch" or environment in settings.learners:
        return 1
    if environment in ENVIRONMENTS and ENVIRONMENTS[environment].engine:
        return 1
    return n_that_fill_lanes(population_size(settings), settings.physics)


def seconds_of_iteration(network: Architecture, training: Training) -> float:
    """Estimate the time of an iteration of training."""
    return _ITERATION + _PASSES_OF_TRAINING * training.batch_size * network.flops / _FLOPS_OF_TRAINING


def seconds_of_throw(settings: Settings, throws: Throws) -> float:
    """Estimate the time of a throw into the target."""
    step = _STEP_OF_THROW + _step_in_numpy(settings, settings.target, math.inf)
    return (throws.n_steps or _STEPS_OF_DESIGNED_THROW) * step


def seconds_of_generation(settings: Settings, environment: EnvironmentName, depth: float) -> float:
    """Estimate the time of a generation of a trial, of one rollout each."""
    return population_size(settings) * seconds_of_rollout(settings, environment, depth)


def seconds_of_rollout(settings: Settings, environment: EnvironmentName, depth: float) -> float:
    """Estimate the time of one rollout of one robot, under all members of an ensemble."""
    n_steps = settings.rollout.n_settle + settings.rollout.n_measure
    engine: str = settings.work.engine
    if engine == "batch" and (settings.physics.link_collisions or settings.physics.passive_joints == "locked"):
        engine = "rigid"
    if learner := settings.learner(environment):
        n_members = 1 if learner.is_single else learner.n_members
        inference = settings.design.n_links.most * learner.network.flops / _FLOPS_OF_INFERENCE
        return n_steps * n_members * (max(_STEP_UNDER_NETWORK, _STEP[engine]) + inference)
    if environment not in ENVIRONMENTS:  # of code that is not here
        return n_steps * _STEP[engine]
    n_members = environment_of(media_of(settings, environment), environment, depth).n_members
    return n_steps * n_members * (_STEP[engine] + _step_in_numpy(settings, environment, depth))


def _step_in_numpy(settings: Settings, environment: EnvironmentName, depth: float) -> float:
    """Estimate the time of a robot's step in a medium without a kernel, beside a step on dry land [s]."""
    if environment not in ENVIRONMENTS:
        return 0.0  # the medium's code is not here
    medium = environment_of(media_of(settings, environment), environment, 0.0).medium
    if (seconds := getattr(medium, "seconds_per_step", None)) is not None:
        return float(seconds(depth))
    if settings.work.engine != "batch":
        return 0.0  # the slush is in NumPy there, too
    if ENVIRONMENTS[environment].engine:
        return _STEP_IN_OTHER_ENGINE
    if medium is None or is_compiled(medium):
        return 0.0
    n_batched = min(batch_size(settings, environment), settings.grid.n_trials)
    return _CALL_OF_MEDIUM / (population_size(settings) * n_batched) + _STEP_IN_MEDIUM


def population_size(settings: Settings) -> int:
    """Return how many designs a generation evaluates; 1 where that is not known."""
    return settings.evolution.population_size or 1
