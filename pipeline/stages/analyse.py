"""analyse: the results of a study as tables, one for each analysis that tasks/analysis/tables registers.

Each work item is one analysis, of the whole study or of one arm, and its file is the table. A missing number is NaN.
"""

import textwrap
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

from pipeline.config.settings import Settings
from pipeline.report.render import as_text, tables_of
from pipeline.report.study_page import scale_words
from pipeline.stages.cost import seconds_of_rollout
from pipeline.stages.reader import DataSpec, StudyReader, data_spec, inputs_of, read_inputs, read_study
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.store.tables import TableFile, columns_of, described, rows_of
from pipeline.workflow.identity import OutputId, arms_of, trials_of
from pipeline.workflow.stage import Chain, Execution, Files, Inputs, Item, Stage, Summary, Upstream
from tasks.analysis.columns import scored_by
from tasks.analysis.comparison import VERDICTS
from tasks.analysis.registry import Analysis
from tasks.analysis.tables import ANALYSES


@dataclass(frozen=True)
class AnalysisSpec:
    """One analysis, of all trials or of those of one arm."""

    analysis: str
    version: int  # of the analysis
    data: DataSpec


def _plan(settings: Settings) -> Sequence[Chain[AnalysisSpec]]:
    """Plan one item for each analysis that applies, or one for each arm."""
    trials, chains = trials_of(settings, "transfer"), []
    learned = next(iter(settings.arm_learners), settings.target)
    for name, table in ANALYSES.items():
        if not applies(table, settings):
            continue
        arms = arms_of(trials).items() if table.each == "arm" else [(None, trials)]
        for arm, of_arm in arms:
            home = arm.environment if arm else learned if "networks" in table.reads else settings.target
            weight = table.cost * sum(seconds_of_rollout(settings, home, trial.depth) for trial in of_arm)
            spec = AnalysisSpec(name, table.version, data_spec(settings, of_arm))
            chains.append(Chain(OutputId(name, arm), (1,), spec, weight=weight))
    return chains


def applies(table: Analysis, settings: Settings) -> bool:
    """Return whether a study has what an analysis is about."""
    networks = settings.needs_ensemble or "networks" not in table.reads
    papers = (settings.has_papers_target and settings.evolution.maximised.is_papers) or table.section != "paper"
    searched = table.search in (None, settings.evolution.search)
    true = table.section != "trust" or settings.learner(settings.target) is None  # else there is none
    engines = bool(settings.transfer.other_engines) or not table.needs_engines
    tank = settings.tank is not None or not table.needs_tank
    return networks and papers and true and searched and engines and tank


def _item(
    settings: Settings, chain: Chain[AnalysisSpec], index: int, previous: Manifest | None, upstream: Upstream
) -> Item[AnalysisSpec]:
    spec = chain.spec
    inputs = inputs_of(settings, spec.data.trials, ANALYSES[spec.analysis].reads, upstream)
    return Item(ANALYSE.name, ANALYSE.version, chain.label, spec, inputs, Execution(settings.work.engine))


def _compute(item: Item[AnalysisSpec], inputs: Inputs) -> Files:
    table, study = ANALYSES[item.spec.analysis], read_inputs(item.spec.data, item.execution, inputs)
    columns = columns_of(table.row, table.compute(study))
    units = {name: about.get("unit", "") for name, about in described(scored_by(study.objective, table.row)).items()}
    file = table_file(table)
    return {file.name: file.encode(columns, units)}


def table_file(table: Analysis) -> TableFile:
    """Return the file of an analysis."""
    return TableFile(table.name, table.version)


def tables_of_study(study: StudyReader, settings: Settings) -> dict[str, list[Any]]:
    """Return the rows of every analysis whose code is here, joined over its work items.

    At a small scale of evolution, metres cannot tell whether a study agrees with the paper.
    """
    tables: dict[str, list[Any]] = {}
    for output, items in study.items("tables").items():
        if table := ANALYSES.get(output.name):
            tables.setdefault(output.name, []).extend(rows_of(table.row, table_file(table).read(items)))
    if scale_words(settings):
        rows = tables.get("paper", ())
        tables["paper"] = [replace(row, verdict="cannot tell") if row.is_metres else row for row in rows]
    return tables


def _summarise(settings: Settings, upstream: Upstream, store: Store) -> Summary:
    """Count how many statements of the paper agree; offer every table of readable size as CSV."""
    tables = tables_of_study(read_study(settings, upstream, store), settings)
    lines, metrics = list[str](), dict[str, float | None]()
    for name, rows in ((name, rows) for name, rows in tables.items() if rows):
        table = ANALYSES[name]
        metrics |= table.metrics(rows)
        if table.section == "tank":
            shown = [row for row in rows if table.shown(row)]
            lines += ["", table.answers, *as_text(table.row, shown, learners=settings.arm_learners)]
        elif table.section == "paper":
            counts = Counter(row.verdict for row in rows)
            told = ", ".join(f"{counts[verdict]} × {verdict}" for verdict in VERDICTS)
            lines += textwrap.wrap(f"{len(rows)} statements of the paper: {told}; the page has the table", 78)
    if settings.evolution.maximised.unit != "m":
        metrics = {f"score{name[1:]}" if name.startswith("m.") else name: value for name, value in metrics.items()}
    known = {name: value for name, value in metrics.items() if value is not None and isfinite(value)}
    counted = ", ".join(f"{name} ({len(rows):,})" for name, rows in tables.items())
    lines = [*textwrap.wrap(f"rows of the tables of study {settings.name}: {counted}", 78), *lines]
    return Summary(lines=lines, metrics=known, artifacts=tables_of(tables, settings.evolution.maximised), of_study=True)


ANALYSE = Stage(
    name="analyse",
    version=14,
    unit="analyses",
    reads=lambda settings: ("train", "evolve", "transfer", "assess"),
    plan=_plan,
    item=_item,
    compute=_compute,
    summarise=_summarise,
)
