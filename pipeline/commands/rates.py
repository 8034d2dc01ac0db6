"""Rates: what work and results cost, timed on this machine in small pieces of the study's own kind."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from pipeline.cluster.process import signals_unwind
from pipeline.commands.sizes import BYTES_OF_A_DESIGN
from pipeline.commands.specimens import N_FEW_THROWS, few_throws, short_film, untrained_ensemble
from pipeline.config.settings import RESIDUAL_ENVIRONMENTS, Settings
from pipeline.errors import PuddleError
from pipeline.report import render_films
from pipeline.stages import environments
from pipeline.stages.segments import segment_lengths
from pipeline.store import disk
from pipeline.store.encoding import Json, key_of
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from tasks.analysis import disagreement, link_states, member_errors, novelty, thrown
from tasks.design import Designs, random_designs
from tasks.evolution import EMPTY_POPULATION, Population, ask, tell
from tasks.residual import initial_states, simulate_throws
from tasks.simulation import simulate
from tasks.world import Environment, EnvironmentName, ResidualSlush

FEWEST_STEPS = 20
"""Steps of the shortest rollout that is timed."""
ENOUGH_SECONDS = 0.3
"""Rollouts are timed over more and more steps until they take so long, or are whole."""
N_CALIBRATION_ITERATIONS = 4
"""Iterations of training that are timed, after as many that are not."""
N_CALIBRATION_GENERATIONS = 16
"""Generations that are asked for and told: what their draws take varies from one to the next."""
N_CALIBRATION_RESULTS = 5


@dataclass(frozen=True)
class Rates:
    """What a unit of each stage's work costs on one core of this machine [s]."""

    throw: float
    iteration: float
    simulation: Mapping[EnvironmentName, float]
    """Of a generation, by the world in which designs are simulated; where trials go side by side, of each of them."""
    selection: Mapping[str, float]
    """Of a generation: asking and telling, by the stage that evolves. Bodies that are given are not drawn."""
    population_size: int
    picture: float
    """Of a film, as GIF and as MP4."""
    look: float
    """At how members err and differ along one rollout."""

    def rollout(self, world: EnvironmentName) -> float:
        """Price one design in a world, as a share of a generation."""
        return self.simulation[world] / self.population_size


def measure(settings: Settings, say: Callable[[str], None]) -> Rates:
    """Time a small piece of each kind of work that these settings ask for."""
    worlds = dict.fromkeys(environment for environment, _, _ in settings.grid.trials())
    worlds["true_slush"] = None  # where champions are put to the test
    if settings.needs_ensemble:
        worlds["residual_slush"] = None  # what predictions are made by
    throw = iteration = 0.0
    if settings.needs_ensemble:
        say("timing throws and training")
        throw, iteration = _time_of_throw(settings), _time_of_iteration(settings)
    simulation = {}
    for world in worlds:
        say(f"timing a generation in {world.replace('_', ' ')}")
        simulation[world] = _time_of_simulation(settings, world)
    say("timing what evolution does between simulations")
    body = random_designs(1, np.random.default_rng(0), morphology=settings.evolution.morphology)
    return Rates(
        throw=throw,
        iteration=iteration,
        simulation=simulation,
        selection={"evolve": time_of_selection(settings, None), "transfer": time_of_selection(settings, body)},
        population_size=settings.evolution.afpo.population_size,
        picture=_time_of_picture(settings),
        look=_time_of_look(settings) if settings.needs_ensemble else 0.0,
    )


def _seconds(function: Callable[[], object]) -> float:
    """Time a call, after one that is not timed: it compiles and fills caches."""
    function()
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def _time_of_throw(settings: Settings) -> float:
    return _seconds(lambda: few_throws(settings)) / N_FEW_THROWS


def _time_of_iteration(settings: Settings) -> float:
    from tasks.residual.training import NoDevice, train_member

    times: list[float] = []
    try:
        train_member(
            few_throws(settings),
            settings.network,
            settings.training.model_copy(update={"n_iterations": 2 * N_CALIBRATION_ITERATIONS}),
            seed=0,
            member=0,
            on_progress=lambda iteration, loss: times.append(time.perf_counter()),
        )
    except NoDevice as missing:
        raise PuddleError(f"{missing}: what a GPU does can be timed only where there is one") from None
    return (times[-1] - times[N_CALIBRATION_ITERATIONS - 1]) / N_CALIBRATION_ITERATIONS


def _world(settings: Settings, world: EnvironmentName, depth: float) -> Environment:
    if world in RESIDUAL_ENVIRONMENTS:
        n_members = settings.ensemble.n_members if world == "residual_slush" else 1
        return ResidualSlush(depth=depth, ensemble=untrained_ensemble(settings, n_members))
    return environments.build_environment(environments.media_of(settings, world), world, depth, {})


def _time_of_simulation(settings: Settings, world: EnvironmentName) -> float:
    """Time a generation's rollouts: a few steps for all, where whole ones take long."""
    afpo = settings.evolution.afpo
    depths = [depth for environment, depth, _ in settings.grid.trials() if environment == world]
    environment = _world(settings, world, float(np.median(depths or list(settings.grid.depths))))
    rng = np.random.default_rng(0)
    morphology = settings.evolution.morphology
    batch_size = environments.batch_size(settings, world)
    designs = random_designs(batch_size * afpo.population_size, rng, morphology=morphology)

    def rollouts(n_steps: int) -> object:
        return simulate(
            designs, environment, n_settle=0, n_measure=n_steps, engine=settings.work.engine, physics=settings.physics
        )

    n_all = settings.rollout.n_settle + settings.rollout.n_measure
    n_steps = min(FEWEST_STEPS, n_all)
    while (seconds := _seconds(partial(rollouts, n_steps))) < ENOUGH_SECONDS and n_steps < n_all:
        n_steps = min(4 * n_steps, n_all)
    return seconds * n_all / n_steps / batch_size


def time_of_selection(settings: Settings, body: Designs | None) -> float:
    """Time asking and telling once there are parents: a trial's first generation alone is random throughout.

    Args:
        settings: the study's.
        body: one design whose controller alone evolves; None where bodies do too.

    Returns:
        Of a generation [s].
    """
    afpo, morphology, rng = settings.evolution.afpo, settings.evolution.morphology, np.random.default_rng(0)

    def generation(population: Population) -> Population:
        children = ask(population, rng, afpo, body=body, morphology=morphology)
        return tell(population, children, rng.normal(size=afpo.population_size), rng, afpo)

    population = generation(generation(EMPTY_POPULATION))
    start = time.perf_counter()
    for _ in range(N_CALIBRATION_GENERATIONS):
        population = generation(population)
    return (time.perf_counter() - start) / N_CALIBRATION_GENERATIONS


def _time_of_picture(settings: Settings) -> float:
    film = short_film(settings)
    return _seconds(lambda: render_films([film])) / len(film.frames)


def _time_of_look(settings: Settings) -> float:
    """Look at a random design's rollout as an arm's instruments do, among all that its members learn from."""
    ensemble = untrained_ensemble(settings, settings.ensemble.n_members)
    design, media = random_designs(1, np.random.default_rng(0)), environments.media_of(settings, "true_slush")
    medium = environments.true_medium(media)
    in_slush = simulate(
        design,
        environments.true_slush(media, max(settings.grid.depths)),
        **settings.rollout.model_dump(),
        engine=settings.work.engine,
        physics=settings.physics,
        trace=True,
    )
    assert in_slush.trace is not None
    trace, physics = in_slush.trace, settings.physics
    throws = settings.throws
    learned = simulate_throws(initial_states(throws, np.random.default_rng(0)), throws.n_steps, medium, physics)
    links = link_states(design, trace, physics)

    def look() -> object:
        index = thrown(learned.observation, learned.throw)
        errors = member_errors(ensemble, medium, links, physics)
        return errors, disagreement(design, trace, ensemble, physics), novelty(links, index)

    return _seconds(look)


def seconds_of_a_result(settings: Settings, root: Path) -> float:
    """Time what a trial's piece costs the driver: to specify it, read its input, keep its result.

    Args:
        settings: the study's.
        root: of a store, which need not be there; its disk is timed, and nothing stays on it.

    Raises:
        PuddleError: nothing can be kept there.
    """
    n_generations = segment_lengths(settings, settings.evolution.n_generations)[0]
    n_rows = n_generations * settings.evolution.afpo.population_size
    history = bytes(int(n_rows * BYTES_OF_A_DESIGN))
    with (
        signals_unwind(),
        disk.explained("timing what a result costs", root),
        tempfile.TemporaryDirectory(dir=_folder_on_the_disk_of(root), prefix="puddle-forecast-") as place,
    ):
        store = Store.open(Path(place) / "store", create=True)

        def keep(number: int) -> Manifest:
            identity: dict[str, Json] = {"stage": "evolve", "number": number}
            files = {"history.parquet": history, "population.safetensors": history[:100_000], "curve.parquet": b" "}
            manifest = store.commit("evolve", key_of(identity), identity, files, record={})
            store.read(manifest, "population.safetensors")
            return manifest

        keep(0)
        start = time.perf_counter()
        for number in range(1, N_CALIBRATION_RESULTS + 1):
            keep(number)
        return (time.perf_counter() - start) / N_CALIBRATION_RESULTS


def _folder_on_the_disk_of(root: Path) -> Path:
    """Choose the folder of temporary files if it is on the same disk: there the system sweeps what a kill -9 leaves."""
    nearest = next(path for path in (root, *root.parents) if path.exists())
    temporary = Path(tempfile.gettempdir())
    return temporary if temporary.stat().st_dev == nearest.stat().st_dev else nearest
