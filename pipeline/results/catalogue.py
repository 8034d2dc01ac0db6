"""The tables of a study by name, as Arrow tables whose first columns are environment, depth and trial.

A table joins the files of all its work items. Units are in the metadata of the fields, under ``unit``. Where a table
is of a whole arm or of the whole study, trial, or all three, are null. Everything else is as the stages wrote it: a
missing number is NaN, and -inf is the fitness of a design that diverged.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from pipeline.stages.analyses import specs
from pipeline.stages.analyses.analysis_tables import ANALYSIS_VERSION
from pipeline.stages.assess import AssessmentId
from pipeline.stages.data_sets import ChunkId, NetworkId
from pipeline.stages.part import PartId
from pipeline.stages.pilot import PilotId
from pipeline.store.encoding import Array, decode_table, units_of
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.identity import ChainId, TrialId
from pipeline.workflow.stage import Results, Upstream
from tasks.evolution import OPERATORS


@dataclass(frozen=True)
class TableSource:
    """Where the rows of a table are."""

    stage: str
    file: str  # name of the Parquet files without suffix, which is also their schema
    version: int = 1
    analysis: str | None = None  # kind of analysis, for tables of the stage analyse

    def has(self, chain: ChainId) -> bool:
        """Return whether the table has rows from a chain."""
        return self.analysis is None or (isinstance(chain, PartId) and chain.name == self.analysis)


def _analysed(kind: str, file: str) -> TableSource:
    return TableSource("analyse", file, ANALYSIS_VERSION, kind)


CATALOGUE: Mapping[str, TableSource] = {
    "histories": TableSource("evolve", "history"),
    "fitness_curves": TableSource("evolve", "curve"),
    "adaptations": TableSource("transfer", "history"),
    "adaptation_curves": TableSource("transfer", "curve"),
    "predictions": TableSource("assess", "predictions"),
    "transitions": TableSource("collect", "transitions"),
    "learning_curves": TableSource("train", "learning"),
    "validation_errors": TableSource("train", "errors"),
    "coverage": TableSource("pilot", "coverage"),
    "pilot_states": TableSource("pilot", "states"),
    "scores": _analysed(specs.STATISTICS, "scores"),
    "regressions": _analysed(specs.STATISTICS, "regressions"),
    "histograms": _analysed(specs.STATISTICS, "histograms"),
    "contrasts": _analysed(specs.STATISTICS, "contrasts"),
    "attribution": _analysed(specs.STATISTICS, "attribution"),
    "paper": _analysed(specs.STATISTICS, "paper"),
    "variance": _analysed(specs.STATISTICS, "variance"),
    "phantom_thrust": _analysed(specs.MEMBERS, "phantom_thrust"),
    "member_errors": _analysed(specs.MEMBERS, "member_errors"),
    "transfer_tests": _analysed(specs.MATRIX, "tests"),
    "transfer_matrix": _analysed(specs.MATRIX, "matrix"),
    "exploiters": _analysed(specs.EXPLOITERS, "exploiters"),
    "instruments": _analysed(specs.INSTRUMENTS, "champions"),
    "champion_coverage": _analysed(specs.INSTRUMENTS, "champion_coverage"),
    "filmed_links": _analysed(specs.INSTRUMENTS, "links"),
    "films": _analysed(specs.INSTRUMENTS, "films"),
    "member_errors_of_champions": _analysed(specs.INSTRUMENTS, "member_errors"),
    "tank": _analysed(specs.TANK, "tank"),
}
"""Tables by name. pipeline/stages/analyse.py lists the columns of those that an analysis makes."""

KEYS: Mapping[str, pa.DataType] = {"environment": pa.string(), "depth": pa.float64(), "trial": pa.int64()}
"""Columns that every table has."""

_SAME_AS = {"environment": "evolved_in", "depth": "trained"}  # columns that give a key under another name


def parts_of(name: str, results: Results, store: Store, *, only: Mapping[str, Any]) -> Iterator[pa.Table]:
    """Yield the rows of a table, one Arrow table for each chain.

    Args:
        name: name of the table.
        results: what the store holds of the table's stage.
        store: where it is.
        only: values of keys that chains must have, if they have the key.
    """
    source = CATALOGUE[name]
    for chain, files in files_of(source, results).items():
        keys = keys_of(chain)
        if any(keys.get(key, value) != value for key, value in only.items()):
            continue
        decoded = []
        units: Mapping[str, str] = {}
        for manifest in files:
            data, where = store.read(manifest, f"{source.file}.parquet"), f"{name}: {chain.label}"
            units = units or units_of(data, where)
            decoded.append(decode_table(data, schema=source.file, version=source.version, source=where))
        columns = {column: np.concatenate([part[column] for part in decoded]) for column in decoded[0]}
        n_rows = len(next(iter(columns.values())))
        yield _arrow_table({**{key: np.full(n_rows, value) for key, value in keys.items()}, **columns}, units)


def files_of(source: TableSource, results: Results) -> dict[ChainId, list[Manifest]]:
    """Return the work items that hold rows of a table, by chain."""
    file = f"{source.file}.parquet"
    found = {
        chain: [manifest for manifest in manifests if file in manifest.files]
        for chain, manifests in results.done.items()
        if source.has(chain)
    }
    return {chain: manifests for chain, manifests in found.items() if manifests}


def available(upstream: Upstream) -> list[str]:
    """Return the names of the tables that have rows in the store."""
    return [name for name, source in CATALOGUE.items() if files_of(source, upstream[source.stage])]


def keys_of(chain: ChainId) -> dict[str, Any]:
    """Return what a chain says of all its rows: the keys that it has, the number of a member, or the data set."""
    if isinstance(chain, TrialId):
        return {"environment": chain.environment, "depth": chain.depth, "trial": chain.index}
    if isinstance(chain, PartId) and chain.arm is not None:
        return {"environment": chain.arm.environment, "depth": chain.arm.depth}
    if isinstance(chain, AssessmentId):
        return {**keys_of(chain.trial), "data_set": chain.data_set.words}
    if isinstance(chain, NetworkId):
        return {"member": chain.index, "data_set": chain.data_set.words}
    return {"data_set": chain.data_set.words} if isinstance(chain, ChunkId | PilotId) else {}


_UNITS = {"environment": "", "depth": "m", "trial": "", "operator": ""}


def _arrow_table(columns: Mapping[str, Array], units: Mapping[str, str]) -> pa.Table:
    """Make a table whose first columns are the keys; null where the columns do not have them."""
    left = {**{key: columns[other] for key, other in _SAME_AS.items() if other in columns}, **columns}
    n_rows = len(next(iter(columns.values())))
    arrays: dict[str, pa.Array] = {}
    for key, kind in KEYS.items():
        arrays[key] = _arrow_array(left.pop(key)).cast(kind) if key in left else pa.nulls(n_rows, kind)
    arrays |= {name: _arrow_array(_named(name, column)) for name, column in left.items()}
    fields = [
        pa.field(name, array.type, metadata={"unit": {**units, **_UNITS}.get(name, "")})
        for name, array in arrays.items()
    ]
    return pa.Table.from_arrays(list(arrays.values()), schema=pa.schema(fields))


def _named(name: str, column: Array) -> Array:
    """Replace the codes of operators by their names."""
    return np.array(OPERATORS)[column] if name == "operator" and column.dtype.kind != "U" else column


def _arrow_array(column: Array) -> pa.Array:
    """Convert a column; several numbers per row become a list, because their number may differ between arms."""
    if column.ndim == 1:
        return pa.array(column.tolist(), pa.string()) if column.dtype.kind == "U" else pa.array(column)
    n_rows, width = column.shape
    return pa.ListArray.from_arrays(np.arange(n_rows + 1, dtype=np.int32) * width, pa.array(column.reshape(-1)))
