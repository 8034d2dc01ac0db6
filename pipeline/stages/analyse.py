"""analyse: the results of a study as tables, one for each analysis that tasks/analysis/tables registers.

Each work item is one analysis, of the whole study or of one arm, and its file is the table. A missing number is NaN.
"""

import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

from pipeline.config.settings import Settings
from pipeline.report.page import scale_words
from pipeline.report.render import as_text, tables_of
from pipeline.stages import environments
from pipeline.stages.study_data import DataSpec, StudyFiles, data_inputs, data_spec
from pipeline.store.encoding import decode_table, encode_table
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.store.tables import Columns, columns_of, described, rows_of
from pipeline.workflow.identity import OutputId, arms_of, trials_of
from pipeline.workflow.stage import Chain, Execution, Files, Inputs, Item, Results, Stage, Summary, Upstream
from tasks.analysis.comparison import VERDICTS
from tasks.analysis.registry import Analysis, scored_by
from tasks.analysis.tables import ANALYSES


@dataclass(frozen=True)
class AnalysisSpec:
    """One analysis, of all trials or of those of one arm."""

    analysis: str
    version: int  # of the analysis
    data: DataSpec


def table_file(name: str) -> str:
    """Return the name of a table's file."""
    return f"{name}.parquet"


def _plan(settings: Settings) -> Sequence[Chain[AnalysisSpec]]:
    """Plan one item for each analysis that applies, or one for each arm."""
    trials, chains = trials_of(settings, "transfer"), []
    learned = next(iter(settings.arm_learners), settings.target)
    for name, one in ANALYSES.items():
        if not applies(one, settings):
            continue
        arms = arms_of(trials).items() if one.each == "arm" else [(None, trials)]
        for arm, own in arms:
            home = arm.environment if arm else learned if "train" in one.reads else settings.target
            weight = one.cost * len(own) * environments.relative_cost(settings, home)
            spec = AnalysisSpec(name, one.version, data_spec(settings, own))
            chains.append(Chain(OutputId(name, arm), (1,), spec, weight=weight))
    return chains


def applies(one: Analysis, settings: Settings) -> bool:
    """Return whether a study has what an analysis is about."""
    networks = settings.needs_ensemble or not {"collect", "train"} & set(one.reads)
    papers = (settings.has_papers_target and settings.evolution.maximised.is_papers) or one.section != "paper"
    searched = one.search in (None, settings.evolution.search)
    true = one.section != "trust" or settings.learner(settings.target) is None  # else there is none
    return networks and papers and true and searched and (settings.tank is not None or not one.needs_tank)


def _item(
    settings: Settings, chain: Chain[AnalysisSpec], index: int, previous: Manifest | None, upstream: Upstream
) -> Item[AnalysisSpec]:
    spec = chain.spec
    inputs = data_inputs(settings, spec.data.trials, ANALYSES[spec.analysis].reads, upstream)
    return Item(ANALYSE.name, ANALYSE.version, chain.label, spec, inputs, Execution(settings.work.engine))


def _compute(item: Item[AnalysisSpec], inputs: Inputs) -> Files:
    one = ANALYSES[item.spec.analysis]
    study = StudyFiles(item.spec.data, item.execution, inputs)
    columns = columns_of(one.row, one.compute(study))
    units = {name: about.get("unit", "") for name, about in described(scored_by(study.objective, one.row)).items()}
    table = encode_table(columns, schema=one.name, version=one.version, producer=item.key, units=units)
    return {table_file(one.name): table}


def read_columns(files: Files, one: Analysis) -> Columns:
    """Read the table of a work item as columns."""
    file = table_file(one.name)
    return decode_table(files[file], schema=one.name, version=one.version, source=file)


def read_tables(done: Mapping[OutputId, Files], settings: Settings) -> dict[str, list[Any]]:
    """Return the rows of every analysis whose code is here, joined over its work items.

    At a small scale of evolution, metres cannot tell whether a study agrees with the paper.
    """
    tables: dict[str, list[Any]] = {}
    for part, files in done.items():
        if one := ANALYSES.get(part.name):
            tables.setdefault(part.name, []).extend(rows_of(one.row, read_columns(files, one)))
    if scale_words(settings):
        found = tables.get("paper", ())
        tables["paper"] = [replace(row, verdict="cannot tell") if row.is_metres else row for row in found]
    return tables


def _summarise(settings: Settings, results: Results, store: Store) -> Summary:
    """Count how many statements of the paper agree; offer every table of readable size as CSV."""
    files = {part: {name: store.read(done, name) for name in done.files} for part, (done,) in results.done.items()}
    tables = read_tables({part: own for part, own in files.items() if isinstance(part, OutputId)}, settings)
    lines, metrics = list[str](), dict[str, float | None]()
    for name, rows in ((name, rows) for name, rows in tables.items() if rows):
        one = ANALYSES[name]
        metrics |= one.metrics(rows)
        if one.section == "tank":
            shown = [row for row in rows if one.shown(row)]
            lines += ["", one.answers, *as_text(one.row, shown, learners=settings.arm_learners)]
        elif one.section == "paper":
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
    reads=lambda settings: ("collect", "train", "evolve", "transfer", "assess"),
    plan=_plan,
    item=_item,
    compute=_compute,
    summarise=_summarise,
)
