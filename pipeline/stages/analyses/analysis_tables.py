"""The tables of the stage analyse in its files: names of its work items, reading and writing."""

from typing import TypeVar

from pipeline.store.encoding import decode_json, decode_table, encode_json, encode_table
from pipeline.store.tables import Columns, rows_of
from pipeline.workflow.stage import Files

ANALYSIS_VERSION = 13  # version of the stage and of its tables
REASONS = "reasons.json"

Tables = dict[str, Columns]
Reasons = dict[str, str]  # why a table is empty or incomplete, by table
AnyRow = TypeVar("AnyRow")


def encode(tables: Tables, reasons: Reasons, *, producer: str) -> Files:
    """Return the tables of a work item as files.

    Args:
        tables: columns by name of the table.
        reasons: by name of the table.
        producer: key of the work item.
    """
    files = {
        f"{name}.parquet": encode_table(columns, schema=name, version=ANALYSIS_VERSION, producer=producer)
        for name, columns in tables.items()
    }
    return {**files, REASONS: encode_json(reasons)}


def read_table(files: Files, name: str) -> Columns:
    """Read a table of a work item as columns."""
    return decode_table(files[f"{name}.parquet"], schema=name, version=ANALYSIS_VERSION, source=f"{name}.parquet")


def read_rows(files: Files | None, name: str, kind: type[AnyRow]) -> list[AnyRow]:
    """Return a table of a work item as rows; none if the work item is not done.

    Args:
        files: files of the work item; None or empty if it is not done.
        name: name of the table, such as "regressions".
        kind: dataclass from which the table was written.
    """
    return rows_of(kind, read_table(files, name)) if files else []


def read_reasons(files: Files) -> Reasons:
    """Read why tables of a work item are empty or incomplete, by table."""
    return dict(decode_json(files[REASONS], REASONS))
