"""Rates: what work and results cost, timed on this machine in small pieces of the study's own kind."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.artifacts import Json, key_of
from pipeline.errors import PuddleError
from pipeline.manifest import Manifest
from pipeline.report import render_gif, render_mp4, replay_of
from pipeline.report.replay import STEPS_PER_SECOND, Replay
from pipeline.settings import RESIDUAL_ENVIRONMENTS, EnvironmentName, Settings
from pipeline.stages.segments import segment_spec, world_of
from pipeline.store import Store
from tasks.analysis import disagreement, link_states, member_errors, novelty, thrown
from tasks.design import random_designs
from tasks.evolution import NOBODY_YET, ask, tell
from tasks.residual import OBSERVATION, initial_states, simulate_throws
from tasks.simulation import simulate
from tasks.world import DryLand, Environment, ResidualSlush, TrueSlush

if TYPE_CHECKING:
    from tasks.residual.ensemble import Ensemble

FEWEST_STEPS = 20
"""Steps of the shortest rollout that is timed."""
ENOUGH_SECONDS = 0.3
"""Rollouts are timed over more and more steps until they take so long, or are whole."""
N_CALIBRATION_ITERATIONS = 4
"""Iterations of training that are timed, after as many that are not."""
N_CALIBRATION_THROWS = 8
N_CALIBRATION_RESULTS = 5
N_OUTPUTS = 3
"""Of a network: a residual's components."""
BYTES_OF_A_DESIGN = 130
"""What a history keeps of one, about."""


@dataclass(frozen=True)
class Rates:
    """What a unit of each stage's work costs on one core of this machine [s]."""

    throw: float
    iteration: float
    generation: Mapping[EnvironmentName, float]
    """By the world in which designs are simulated."""
    population_size: int
    selection: float
    """Asking and telling, a generation's part that is not simulation [s]."""
    picture: float
    """Of a film, as GIF and as MP4."""
    look: float
    """At how members err and differ along one rollout."""

    def rollout(self, world: EnvironmentName) -> float:
        """Price one design in a world, as a share of a generation."""
        return self.generation[world] / self.population_size


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
    generation = {}
    for world in worlds:
        say(f"timing a generation in {world.replace('_', ' ')}")
        generation[world] = _time_of_generation(settings, world)
    return Rates(
        throw=throw,
        iteration=iteration,
        generation=generation,
        population_size=settings.evolution.afpo.population_size,
        selection=_time_of_selection(settings),
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
    throws = settings.throws.model_copy(update={"n_throws": N_CALIBRATION_THROWS})
    starts = initial_states(throws, np.random.default_rng(0))
    return _seconds(lambda: simulate_throws(starts, throws.n_steps, settings.slush, settings.physics)) / len(starts)


def _time_of_iteration(settings: Settings) -> float:
    from tasks.residual.training import NoDevice, train_member

    throws = settings.throws.model_copy(update={"n_throws": N_CALIBRATION_THROWS})
    starts = initial_states(throws, np.random.default_rng(0))
    transitions = simulate_throws(starts, throws.n_steps, settings.slush, settings.physics)
    times: list[float] = []
    try:
        train_member(
            transitions,
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
    return world_of(segment_spec(settings, stage="forecast", environment=world, world=world, depth=depth, trial=0), {})


def untrained_ensemble(settings: Settings, n_members: int) -> Ensemble:
    """Make networks of the right size that change velocities by about a millimetre per second."""
    from tasks.residual.ensemble import Ensemble

    rng = np.random.default_rng(0)
    widths = [len(OBSERVATION), *[settings.network.width] * settings.network.hidden_layers, N_OUTPUTS]
    scales = [1.0] * settings.network.hidden_layers + [1e-3]
    return Ensemble(
        weights=tuple(
            (scale * rng.normal(size=(n_members, n_in, n_out)) / np.sqrt(n_in)).astype(np.float32)
            for n_in, n_out, scale in zip(widths[:-1], widths[1:], scales, strict=True)
        ),
        biases=tuple(np.zeros((n_members, n_out), np.float32) for n_out in widths[1:]),
    )


def _time_of_generation(settings: Settings, world: EnvironmentName) -> float:
    """Time a whole generation: asking, simulating a few steps for all, telling."""
    afpo = settings.evolution.afpo
    depths = [depth for environment, depth, _ in settings.grid.trials() if environment == world]
    environment = _world(settings, world, float(np.median(depths or list(settings.grid.depths))))
    rng = np.random.default_rng(0)
    morphology = settings.evolution.morphology
    designs = random_designs(afpo.population_size, rng, morphology=morphology)

    def rollouts(n_steps: int) -> object:
        return simulate(
            designs, environment, n_settle=0, n_measure=n_steps, engine=settings.work.engine, physics=settings.physics
        )

    n_all = settings.rollout.n_settle + settings.rollout.n_measure
    n_steps = min(FEWEST_STEPS, n_all)
    while (seconds := _seconds(partial(rollouts, n_steps))) < ENOUGH_SECONDS and n_steps < n_all:
        n_steps = min(4 * n_steps, n_all)
    return seconds * n_all / n_steps + _time_of_selection(settings)


def _time_of_selection(settings: Settings) -> float:
    afpo, morphology, rng = settings.evolution.afpo, settings.evolution.morphology, np.random.default_rng(0)

    def selection() -> object:
        children = ask(NOBODY_YET, rng, afpo, morphology=morphology)
        population = tell(NOBODY_YET, children, rng.normal(size=afpo.population_size), rng, afpo)
        more = ask(population, rng, afpo, morphology=morphology)
        return tell(population, more, rng.normal(size=afpo.population_size), rng, afpo)

    return _seconds(selection)


def _time_of_picture(settings: Settings) -> float:
    film = short_film(settings)
    return _seconds(lambda: (render_gif([film]), render_mp4([film]))) / len(film.frames)


def short_film(settings: Settings) -> Replay:
    """Film a random design for a second."""
    design = random_designs(1, np.random.default_rng(0))
    rollouts = simulate(
        design, DryLand(0.0), n_settle=0, n_measure=STEPS_PER_SECOND, engine=settings.work.engine, trace=True
    )
    assert rollouts.trace is not None
    return replay_of(
        design,
        rollouts.trace[0],
        title="a film",
        environment="dry_land",
        world="Dry Land",
        depth=0.0,
        has_medium=False,
        n_settle=0,
    )


def _time_of_look(settings: Settings) -> float:
    """Look at a random design's rollout as an arm's instruments do, among all that its members learn from."""
    ensemble = untrained_ensemble(settings, settings.ensemble.n_members)
    design, medium = random_designs(1, np.random.default_rng(0)), settings.slush
    in_slush = simulate(
        design, TrueSlush(max(settings.grid.depths), medium), **settings.rollout.model_dump(),
        engine=settings.work.engine, physics=settings.physics, trace=True,
    )  # fmt: skip
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


def seconds_of_a_result(settings: Settings, folder: Path) -> float:
    """Time what a trial's piece costs the driver: to specify it, read its input, keep its result.

    Args:
        settings: the study's.
        folder: on the disk where the store is to be; nothing stays in it.
    """
    n_rows = settings.work.generations_per_item * settings.evolution.afpo.population_size
    history = bytes(int(n_rows * BYTES_OF_A_DESIGN))
    with tempfile.TemporaryDirectory(dir=folder, prefix=".puddle-forecast-") as place:
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
