"""Forecast: how long a study will take and how much it will keep, from rates measured on this machine just now."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pipeline.commands.rates import Rates, measure, seconds_of_a_result
from pipeline.commands.schedule import Schedule, Work, play
from pipeline.commands.sizes import Sizes, bytes_left, n_worlds_looked_at, weigh
from pipeline.config.settings import Settings
from pipeline.stages import STAGES, environments
from pipeline.store import disk
from pipeline.store.store import Store
from pipeline.workflow.graph import survey
from pipeline.workflow.stage import AnyStage, Chain, Results

N_PIECES_PLAYED = 4
"""Of the longest trial, where a schedule is played through."""
SOON_ENOUGH = 1.05
"""Times the soonest end; of what ends so soon, the coarsest grain is best."""


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


def forecast(
    settings: Settings, stages: Sequence[AnyStage], rates: Rates, sizes: Sizes, upstream: Mapping[str, Results]
) -> list[StageForecast]:
    """Price the work that the store does not hold yet, and weigh what it will keep, stage by stage."""
    forecasts = []
    for stage in stages:
        n_units = core_seconds = longest = n_bytes = 0.0
        for chain in stage.plan(settings):
            n_done = upstream[stage.name].n_done.get(chain.identity, 0) if stage.name in upstream else 0
            n_left = sum(chain.units[n_done:])
            seconds = n_left * _price(stage, chain, rates)
            n_units, core_seconds, longest = n_units + n_left, core_seconds + seconds, max(longest, seconds)
            n_bytes += bytes_left(stage, chain, n_done, settings, sizes)
        forecasts.append(StageForecast(stage.name, stage.unit, n_units, core_seconds, longest, n_bytes))
    return forecasts


def _price(stage: AnyStage, chain: Chain[Any], rates: Rates) -> float:
    match stage.unit:
        case "throws":
            return rates.throw
        case "iterations":
            return rates.iteration
        case "generations":
            return rates.simulation[chain.spec.environment] + rates.selection[stage.name]
        case "designs":
            return rates.rollout("true_slush") + rates.rollout("residual_slush")
        case "analyses":
            rollouts = float(chain.spec.n_rollouts) * rates.rollout(chain.spec.environment)
            return rollouts + n_worlds_looked_at(chain.spec) * rates.look
        case "pictures":
            return rates.picture
    raise ValueError(f"stage {stage.name}: its work is counted in {stage.unit}, which has no price")


def works_of(stage: AnyStage, chain: Chain[Any], n_done: int, settings: Settings, rates: Rates) -> list[Work]:
    """Say what is left of a chain, as tasks for cores."""
    price = _price(stage, chain, rates)
    if stage.unit != "generations":
        return [Work(1, 1, units * price) for units in chain.units[n_done:]]
    size = environments.execution_options(settings, chain.spec.environment).designs_per_batch
    n_designs = rates.population_size
    if size is None or size >= n_designs:
        return [Work(1, 1, units * price) for units in chain.units[n_done:]]
    batch_seconds = rates.simulation[chain.spec.environment] * size / n_designs
    n_batches, select = math.ceil(n_designs / size), rates.selection[stage.name]
    # What is less than a generation, such as the scoring of champions, is not split.
    return [
        Work(round(units), n_batches, batch_seconds, select) if units >= 1 else Work(1, 1, units * price)
        for units in chain.units[n_done:]
    ]


def schedule(
    settings: Settings, stage: AnyStage, upstream: Mapping[str, Results], rates: Rates, n_cores: int, driver: float
) -> Schedule:
    """Play a stage through on simulated cores, long trials in part: their generations are alike."""
    chains = stage.plan(settings)
    n_done = upstream[stage.name].n_done if stage.name in upstream else {}
    works = [works_of(stage, chain, n_done.get(chain.identity, 0), settings, rates) for chain in chains]
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


def forecast_lines(settings: Settings, root: Path, cores: Sequence[int], *, say: Callable[[str], None]) -> list[str]:
    """Say what is left of a study, for this machine's cores and for others.

    Args:
        settings: the study's.
        root: of the store, which knows what is done already; if there is none, nothing is.
        cores: numbers of cores, of this machine's kind, to say it for besides this machine's own.
        say: shows what is being measured.

    Raises:
        PuddleError: the store can't be read; or, where ``cores`` asks for it, nothing can be kept on its disk.
    """
    root = root.expanduser().resolve()
    with disk.explained("looking for a store", root):
        store = Store.open(root, create=False) if (root / "store.json").exists() else None
    driver = seconds_of_a_result(settings, root) if cores else 0.0
    upstream = survey(settings, STAGES, store, say=say) if store is not None else {}
    rates = measure(settings, say)
    say("weighing a little of everything")
    stages = forecast(settings, STAGES, rates, weigh(settings), upstream)
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
    for n in dict.fromkeys(cores):
        lines += schedule_lines(settings, upstream, rates, n, driver)
    if store is not None:
        lines.append(f"\nThe store holds {store.size_bytes() / 1e6:.0f} MB now.")
    return lines
