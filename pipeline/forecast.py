"""Forecast: how long a study will take and how much it will keep, from rates measured on this machine just now."""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.artifacts import Json, encode_table, key_of
from pipeline.errors import PuddleError
from pipeline.manifest import Manifest
from pipeline.report import render_gif, render_mp4, replay_of
from pipeline.report.replay import STEPS_PER_SECOND
from pipeline.schedule import Schedule, Work, play
from pipeline.settings import RESIDUAL_ENVIRONMENTS, EnvironmentName, Settings
from pipeline.stage import Chain, Results, Stage
from pipeline.stages import STAGES, segments
from pipeline.stages.segments import history_units, segment_spec, world_of
from pipeline.store import Store
from pipeline.study import survey
from tasks.design import random_designs
from tasks.evolution import NOBODY_YET, Evaluation, ask, evolve, tell
from tasks.residual import OBSERVATION, initial_states, simulate_throws
from tasks.simulation import simulate
from tasks.world import DryLand, Environment, ResidualSlush

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
N_PIECES_PLAYED = 4
"""Of the longest trial, where a schedule is played through."""
SOON_ENOUGH = 1.05
"""Times the soonest end; of what ends so soon, the coarsest grain is best."""


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
    bytes_per_design: float
    """What a trial's history keeps of each evaluated design [bytes]."""

    def rollout(self, world: EnvironmentName) -> float:
        """Price one design in a world, as a share of a generation."""
        return self.generation[world] / self.population_size


@dataclass(frozen=True)
class StageForecast:
    """A stage's work that is still to do."""

    stage: str
    unit: str
    n_units: float
    core_seconds: float
    longest_chain_seconds: float
    """No number of cores gets below this."""
    n_bytes: float


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
        bytes_per_design=bytes_per_design(settings),
    )


def forecast(
    settings: Settings, stages: Sequence[Stage], rates: Rates, upstream: Mapping[str, Results]
) -> list[StageForecast]:
    """Price the work that the store does not hold yet, stage by stage."""
    forecasts = []
    for stage in stages:
        n_units = core_seconds = longest = n_bytes = 0.0
        for chain in stage.plan(settings):
            n_done = upstream[stage.name].n_done.get(chain.label, 0) if stage.name in upstream else 0
            n_left = sum(chain.units[n_done:])
            seconds = n_left * _price(stage, chain, rates)
            n_units, core_seconds, longest = n_units + n_left, core_seconds + seconds, max(longest, seconds)
            if stage.unit == "generations":
                n_bytes += n_left * settings.evolution.afpo.population_size * rates.bytes_per_design
        forecasts.append(StageForecast(stage.name, stage.unit, n_units, core_seconds, longest, n_bytes))
    return forecasts


def _price(stage: Stage, chain: Chain, rates: Rates) -> float:
    match stage.unit:
        case "throws":
            return rates.throw
        case "iterations":
            return rates.iteration
        case "generations":
            return rates.generation[chain.spec["world"]]
        case "designs":
            return rates.rollout("true_slush") + rates.rollout("residual_slush")
        case "analyses":
            return float(chain.spec["n_rollouts"]) * rates.rollout(chain.spec["world"])
        case "pictures":
            return rates.picture
    raise ValueError(f"stage {stage.name}: its work is counted in {stage.unit}, which has no price")


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
        return ResidualSlush(depth=depth, ensemble=_untrained_ensemble(settings, n_members))
    return world_of(segment_spec(settings, stage="forecast", environment=world, world=world, depth=depth, trial=0), {})


def _untrained_ensemble(settings: Settings, n_members: int) -> Ensemble:
    """Make networks of the right size that change velocities by about a millimetre per second."""
    from tasks.residual.ensemble import Ensemble

    rng = np.random.default_rng(0)
    widths = [len(OBSERVATION), *[settings.network.width] * settings.network.hidden_layers, 3]
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
    """Film a random design for a second."""
    design = random_designs(1, np.random.default_rng(0))
    rollouts = simulate(
        design, DryLand(0.0), n_settle=0, n_measure=STEPS_PER_SECOND, engine=settings.work.engine, trace=True
    )
    assert rollouts.trace is not None
    replay = replay_of(
        design,
        rollouts.trace[0],
        title="a film",
        environment="dry_land",
        world="Dry Land",
        depth=0.0,
        has_medium=False,
        n_settle=0,
    )
    return _seconds(lambda: (render_gif([replay]), render_mp4([replay]))) / len(replay.frames)


def bytes_per_design(settings: Settings) -> float:
    """Return what a trial's history keeps of each evaluated design [bytes]: a short one is encoded and weighed."""
    n_members = settings.ensemble.n_members if settings.needs_ensemble else 1
    rng = np.random.default_rng(0)

    def random_scores(n_designs: int) -> Evaluation:
        displacement = rng.normal(size=(n_designs, n_members))
        return Evaluation(fitness=displacement.mean(axis=1), displacement=displacement, com_displacement=displacement)

    _, history = evolve(
        NOBODY_YET, lambda designs: random_scores(len(designs)), lambda generation: rng,
        first_generation=0, n_generations=8, afpo=settings.evolution.afpo,
    )  # fmt: skip
    data = encode_table(history, schema="history", version=1, producer="", units=history_units())
    return len(data) / len(history["fitness"])


def seconds_of_a_result(settings: Settings, folder: Path) -> float:
    """Time what a trial's piece costs the driver: to specify it, read its input, keep its result.

    Args:
        settings: the study's.
        folder: on the disk where the store is to be; nothing stays in it.
    """
    n_rows = settings.work.generations_per_item * settings.evolution.afpo.population_size
    history = bytes(int(n_rows * bytes_per_design(settings)))
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


def works_of(stage: Stage, chain: Chain, n_done: int, settings: Settings, rates: Rates) -> list[Work]:
    """Say what is left of a chain, as tasks for cores."""
    price = _price(stage, chain, rates)
    if stage.unit != "generations":
        return [Work(1, 1, units * price) for units in chain.units[n_done:]]
    size = segments.how(settings, chain.spec["world"])["designs_per_batch"]
    n_designs = rates.population_size
    if size is None or size >= n_designs:
        return [Work(1, 1, units * price) for units in chain.units[n_done:]]
    select = min(rates.selection, price)
    batch_seconds = (price - select) * min(size, n_designs) / n_designs
    n_batches = math.ceil(n_designs / size)
    # What is less than a generation, such as the scoring of champions, is not split.
    return [
        Work(round(units), n_batches, batch_seconds, select) if units >= 1 else Work(1, 1, units * price)
        for units in chain.units[n_done:]
    ]


def schedule(
    settings: Settings, stage: Stage, upstream: Mapping[str, Results], rates: Rates, n_cores: int, driver: float
) -> Schedule:
    """Play a stage through on simulated cores, long trials in part: their generations are alike."""
    chains = stage.plan(settings)
    n_done = upstream[stage.name].n_done if stage.name in upstream else {}
    works = [works_of(stage, chain, n_done.get(chain.label, 0), settings, rates) for chain in chains]
    longest = max((len(pieces) for pieces in works), default=0)
    share = min(1.0, N_PIECES_PLAYED / longest) if longest else 1.0
    played = play([pieces[: max(1, round(share * len(pieces)))] for pieces in works], n_cores, driver_seconds=driver)
    return replace(played, seconds=played.seconds / share, critical_seconds=played.critical_seconds / share)


def schedule_lines(
    settings: Settings, upstream: Mapping[str, Results], rates: Rates, n_cores: int, driver: float
) -> list[str]:
    """Say how a cluster would be kept busy, and which grain would keep it so."""
    lines = [
        "",
        f"on {n_cores:,} cores, the schedule played through (a result costs the driver {driver * 1e3:.0f} ms):",
        f"{'stage':<10}{'to the end':>14}{'longest chain':>16}{'cores busy':>12}{'driver busy':>13}",
    ]
    evolution: Schedule | None = None
    for stage in STAGES:
        played = schedule(settings, stage, upstream, rates, n_cores, driver)
        if not played.seconds:
            continue
        evolution = played if stage.name == "evolve" else evolution
        lines.append(
            f"{stage.name:<10}{played.seconds / 3600:12.2f} h{played.critical_seconds / 3600:14.2f} h"
            f"{played.busy:12.0%}{played.driver_busy:13.0%}"
        )
    if evolution is not None:
        lines += _advice(settings, evolution, upstream, rates, n_cores, driver)
    return lines


def _advice(
    settings: Settings, now: Schedule, upstream: Mapping[str, Results], rates: Rates, n_cores: int, driver: float
) -> list[str]:
    """Recommend the coarsest batches that end evolution soonest, or nearly so."""
    (evolve_stage,) = (stage for stage in STAGES if stage.name == "evolve")
    grains: list[tuple[int | None, Schedule]] = [(settings.work.designs_per_batch, now)]
    for size in (size for size in (32, 16, 8, 4, 2) if size < rates.population_size):
        work = settings.work.model_copy(update={"designs_per_batch": size})
        finer = settings.model_copy(update={"work": work})
        grains.append((size, schedule(finer, evolve_stage, upstream, rates, n_cores, driver)))
    soonest = min(played.seconds for _, played in grains)
    grain, best = next(grain for grain in grains if grain[1].seconds <= SOON_ENOUGH * soonest)
    if best is now:
        return [f"No other grain ends evolution sooner: work.designs_per_batch={grain or 'null'} is right here."]
    why = f"{len(evolve_stage.plan(settings)):,} trials alone keep {now.busy:.0%} of {n_cores:,} cores busy"
    return [
        f"{why}: with `--set work.designs_per_batch={grain}` evolution takes {best.seconds / 3600:.2f} h instead of "
        f"{now.seconds / 3600:.2f} h, and keeps {best.busy:.0%} busy."
    ]


def forecast_lines(
    settings: Settings, store: Store | None, cores: Sequence[int], *, say: Callable[[str], None]
) -> list[str]:
    """Say what is left of a study, for this machine's cores and for others.

    Args:
        settings: the study's.
        store: what is done already; None if nothing is.
        cores: numbers of cores, of this machine's kind, to say it for besides this machine's own.
        say: shows what is being measured.
    """
    upstream = survey(settings, STAGES, store, say=say) if store is not None else {}
    rates = measure(settings, say)
    stages = forecast(settings, STAGES, rates, upstream)
    own = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    columns = dict.fromkeys([own, *cores])
    lines = [f"study {settings.name}: what is left, from rates measured on this machine just now", ""]
    header = "".join(f"{f'{n} cores':>14}" for n in columns)
    lines.append(f"{'stage':<10}{'work':>22}{'core-hours':>12}{header}{'kept':>12}")
    total = dict.fromkeys(columns, 0.0)
    for stage in stages:
        hours = {n: max(stage.core_seconds / n, stage.longest_chain_seconds) / 3600 for n in columns}
        for n in columns:
            total[n] += hours[n]
        lines.append(
            f"{stage.stage:<10}{f'{stage.n_units:,.0f} {stage.unit}':>22}{stage.core_seconds / 3600:12.2f}"
            + "".join(f"{hours[n]:12.2f} h" for n in columns)
            + f"{stage.n_bytes / 1e6:9.0f} MB"
        )
    core_hours, kept = sum(s.core_seconds for s in stages) / 3600, sum(s.n_bytes for s in stages) / 1e6
    lines.append(
        f"{'all':<10}{'':>22}{core_hours:12.2f}" + "".join(f"{total[n]:12.2f} h" for n in columns) + f"{kept:9.0f} MB"
    )
    driver = seconds_of_a_result(settings, store.root if store is not None else Path())
    for n in dict.fromkeys(cores):
        lines += schedule_lines(settings, upstream, rates, n, driver)
    if store is not None:
        lines.append(f"\nThe store holds {store.size_bytes() / 1e6:.0f} MB now.")
    return lines
