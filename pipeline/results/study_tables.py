"""The tables of a study by name, as Arrow tables whose first columns are environment, depth and trial.

A table joins the files of all its work items: those of the stages below, and those of every registered analysis. Where
a table is of the whole study, its keys are null. A missing number is NaN, and -inf is the fitness of a design that
diverged. Each field has its unit in its metadata, and where an analysis describes it, its label and meaning.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from pipeline.stages.analyse import table_file
from pipeline.stages.data_sets import AssessmentId, ChunkId, DataSetId, NetworkId
from pipeline.stages.files import CURVE, ERRORS, HISTORY, LEARNING, PREDICTIONS, TRANSITIONS
from pipeline.store.encoding import Array, units_of
from pipeline.store.store import Store
from pipeline.store.tables import TableFile, described
from pipeline.workflow.identity import ChainId, OutputId, TrialId
from pipeline.workflow.stage import Files, Results, StoredFiles, Upstream
from tasks.analysis.columns import scored_by
from tasks.analysis.tables import ANALYSES
from tasks.evolution import OBJECTIVES, PAPERS_OBJECTIVE, Objective


@dataclass(frozen=True)
class TableSource:
    """Where the rows of a table are."""

    stage: str
    file: TableFile

    def is_there(self, results: Results) -> bool:
        """Return whether there are rows."""
        return any(self.file.name in item.files for items in results.done.values() for item in items)

    def parts(self, results: Results, store: Store) -> dict[ChainId, list[Files]]:
        """Return the files of the work items that hold rows, by chain."""
        holding: dict[ChainId, list[Files]] = {
            chain: [StoredFiles(store, item) for item in items if self.file.name in item.files]
            for chain, items in results.done.items()
        }
        return {chain: items for chain, items in holding.items() if items}


SOURCES: Mapping[str, TableSource] = {
    "histories": TableSource("evolve", HISTORY),
    "fitness_curves": TableSource("evolve", CURVE),
    "adaptations": TableSource("adapt", HISTORY),
    "adaptation_curves": TableSource("adapt", CURVE),
    "predictions": TableSource("assess", PREDICTIONS),
    "transitions": TableSource("collect", TRANSITIONS),
    "learning_curves": TableSource("train", LEARNING),
    "validation_errors": TableSource("train", ERRORS),
    **{name: TableSource("analyse", table_file(analysis)) for name, analysis in ANALYSES.items()},
}
"""Tables by name."""

_ABOUT = {
    "champions": "The best design of each trial, with its predicted, zero-shot and adapted displacement.",
    "histories": "Every design that lived in an evolution: its genes, parents, fitness and displacement.",
    "fitness_curves": "Best fitness in each generation of every trial.",
    "adaptations": "Every controller that lived in an adaptation of a champion to the target.",
    "adaptation_curves": "Best fitness in each generation of every adaptation.",
    "predictions": "Designs of all generations: the networks' prediction of each, and its true displacement.",
    "transitions": "What the throws taught: states of bars, and what the base simulator gets wrong there.",
    "learning_curves": "Loss of every network over its training.",
    "validation_errors": "Errors of every network on throws that it did not learn from.",
}

KEYS: Mapping[str, pa.DataType] = {"environment": pa.string(), "depth": pa.float64(), "trial": pa.int64()}
"""Columns that every table has."""

_UNITS = {"environment": "", "depth": "m", "trial": "", "operator": ""}


def available(upstream: Upstream) -> dict[str, TableSource]:
    """Return the tables that have rows in the store, by name; also those of analyses whose code is not here."""
    specs = [manifest.identity["spec"] for (manifest,) in upstream["analyse"].done.values()]
    made = {spec["analysis"]: TableSource("analyse", TableFile(spec["analysis"], spec["version"])) for spec in specs}
    sources = {**SOURCES, **made}
    return {name: source for name, source in sources.items() if source.is_there(upstream[source.stage])}


def about(name: str) -> str:
    """Say in a sentence what a table holds; "" of an analysis whose code is not here."""
    return _ABOUT.get(name) or (ANALYSES[name].answers if name in ANALYSES else "")


def parts_of(
    name: str,
    upstream: Upstream,
    store: Store,
    *,
    only: Mapping[str, Any],
    objective: Objective = OBJECTIVES[PAPERS_OBJECTIVE],
) -> Iterator[pa.Table]:
    """Yield the rows of a table, an Arrow table for each chain whose keys have the values of ``only``, if any."""
    source = available(upstream)[name]
    for chain, items in source.parts(upstream[source.stage], store).items():
        keys, where = keys_of(chain), f"{name}: {chain.label}"
        if any(keys.get(key, value) != value for key, value in only.items()):
            continue
        units, columns = units_of(items[0][source.file.name], where), source.file.read(items, where)
        n_rows = len(next(iter(columns.values())))
        rows = {**{key: np.full(n_rows, value) for key, value in keys.items()}, **columns}
        yield _arrow_table(rows, units, described(scored_by(objective, ANALYSES[name].row)) if name in ANALYSES else {})


def keys_of(chain: ChainId) -> dict[str, Any]:
    """Return what a chain says of all its rows: the keys that it has, the number of a member, or the data set."""
    if isinstance(chain, TrialId):
        return {"environment": chain.environment, "depth": chain.depth, "trial": chain.index}
    if isinstance(chain, OutputId) and chain.arm is not None:
        return {"environment": chain.arm.environment, "depth": chain.arm.depth}
    if isinstance(chain, AssessmentId):
        return {**keys_of(chain.trial), "data_set": chain.data_set.label}
    if isinstance(chain, NetworkId):
        return {"member": chain.index, "data_set": chain.data_set.label}
    if isinstance(chain, ChunkId):
        return {"data_set": chain.data_set.label}
    return {"data_set": chain.label} if isinstance(chain, DataSetId) else {}


def _arrow_table(
    columns: Mapping[str, Array], units: Mapping[str, str], about: Mapping[str, Mapping[str, Any]]
) -> pa.Table:
    """Make a table whose first columns are the keys; null where the columns do not have them."""
    left, n_rows = dict(columns), len(next(iter(columns.values())))
    arrays: dict[str, pa.Array] = {}
    for key, kind in KEYS.items():
        arrays[key] = _arrow_array(left.pop(key)).cast(kind) if key in left else pa.nulls(n_rows, kind)
    if "operator" in left and left["operator"].dtype.kind != "U":
        names = [coded.split()[1] for coded in units["operator"].split(", ")]  # "0 random, 1 mutation, ..."
        left["operator"] = np.array(names)[left["operator"]]
    arrays |= {name: _arrow_array(column) for name, column in left.items()}
    units = {**units, **_UNITS}
    fields = [
        field_of(name, array.type, {**about.get(name, {}), "unit": units.get(name, "")})
        for name, array in arrays.items()
    ]
    return pa.Table.from_arrays(list(arrays.values()), schema=pa.schema(fields))


def field_of(name: str, kind: pa.DataType, about: Mapping[str, Any]) -> pa.Field:
    """Describe a column: its unit, and its label and meaning where it has them."""
    says = {word: about[word] for word in ("label", "meaning") if about.get(word)}
    return pa.field(name, kind, metadata={"unit": about.get("unit", ""), **says})


def _arrow_array(column: Array) -> pa.Array:
    """Convert a column; several numbers per row become a list, because their number may differ between arms."""
    if column.ndim == 1:
        return pa.array(column.tolist(), pa.string()) if column.dtype.kind == "U" else pa.array(column)
    n_rows, width = column.shape
    return pa.ListArray.from_arrays(np.arange(n_rows + 1, dtype=np.int32) * width, pa.array(column.reshape(-1)))
