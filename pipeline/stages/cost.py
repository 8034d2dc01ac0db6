"""What a generation costs in an environment, relative to one on dry land, and how many trials to compute together."""

from pipeline.config.settings import Settings
from pipeline.stages.environments import environment_of, media_of
from tasks.simulation.batch import n_that_fill_lanes
from tasks.simulation.fluids import is_compiled
from tasks.world import ENVIRONMENTS, EnvironmentName

SECONDS_PER_STEP = 0.2e-6  # of one robot on dry land in the batch engine
_FLOPS_OF_PHYSICS = 8e3  # approximate cost of one link's Box2D step, to weigh networks against
_OTHER_ENGINE = 1000.0  # approximate cost of a robot's step in MuJoCo, against one in the batch engine
_CALL_OF_MEDIUM, _ROBOT_IN_MEDIUM = 500.0, 2.5  # approximate cost of NumPy, against a robot's step on dry land


def batch_size(settings: Settings, environment: EnvironmentName) -> int:
    """Return how many trials of an environment fill the engine's lanes together, where one leaves some empty."""
    # An ensemble fills the lanes, and single members differ between trials.
    if settings.work.engine != "batch" or environment in settings.learners:
        return 1
    if environment in ENVIRONMENTS and ENVIRONMENTS[environment].engine:
        return 1
    size = getattr(settings.evolution.optimiser, "population_size", 1)  # unknown of a search that is not here
    return n_that_fill_lanes(size, settings.physics)


def relative_cost(settings: Settings, environment: EnvironmentName) -> float:
    """Estimate the cost of a generation, relative to one on dry land."""
    n_members, learner = number_of_members(settings, environment), settings.learner(environment)
    medium = learner.network.flops / _FLOPS_OF_PHYSICS if learner else cost_in_numpy(settings, environment)
    return n_members * (1 + medium)


def cost_in_numpy(settings: Settings, environment: EnvironmentName) -> float:
    """Estimate what a robot's step costs in a medium without a kernel, beside a step on dry land and relative to it."""
    if environment not in ENVIRONMENTS:
        return 0.0  # the medium's code is not here
    home = environment_of(media_of(settings, environment), environment, 0.0)
    if (seconds := getattr(home.medium, "seconds_per_step", None)) is not None:
        return float(seconds) / SECONDS_PER_STEP
    if settings.work.engine != "batch":
        return 0.0  # the slush is in NumPy there, too
    if ENVIRONMENTS[environment].engine:
        return _OTHER_ENGINE
    if home.medium is None or is_compiled(home.medium):
        return 0.0
    n_batched = min(batch_size(settings, environment), settings.grid.n_trials)
    return _CALL_OF_MEDIUM / (settings.evolution.optimiser.population_size * n_batched) + _ROBOT_IN_MEDIUM


def number_of_members(settings: Settings, environment: EnvironmentName) -> int:
    """Return how many members simulate each design in an environment, 1 without an ensemble."""
    if learner := settings.learner(environment):
        return 1 if learner.is_single else learner.n_members
    if environment not in ENVIRONMENTS:  # of code that is not here
        return 1
    return environment_of(media_of(settings, environment), environment, 0.0).n_members
