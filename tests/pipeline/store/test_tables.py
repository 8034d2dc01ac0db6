"""Rows of frozen data as columns: every kind of field, with rows and without, through Parquet and into CSV."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pipeline.store.encoding import decode_table, encode_table
from pipeline.store.tables import columns_of, csv_of
from tasks.analysis import Comparison, Contrast, Estimate


@dataclass(frozen=True)
class Row:
    name: str
    n: int
    best: bool
    side: tuple[Literal["a", "b"], str]
    found: Estimate
    p: float | None
    why: str | None


ROWS = (
    Row("x", 3, True, ("a", "c"), Estimate(1.5, 1.0, 2.0), 0.25, None),
    Row("y", 4, False, ("b", "d"), Estimate.missing("no, nothing"), None, "none"),
)
NAMES = ("name", "n", "best", "side", "found", "found_low", "found_high", "found_reason", "p", "why")


def through_parquet(columns):
    return decode_table(encode_table(columns, schema="t", version=1, producer=""), schema="t", version=1, source="t")


def test_rows_become_columns_that_parquet_keeps():
    columns = through_parquet(columns_of(Row, ROWS))
    assert tuple(columns) == NAMES
    assert columns["side"].tolist() == ["a/c", "b/d"]
    assert columns["found"][0] == 1.5 and np.isnan([columns[n][1] for n in ("found", "found_low", "p")]).all()
    assert columns["found_reason"].tolist() == ["", "no, nothing"] and columns["why"].tolist() == ["", "none"]


def test_without_rows_columns_keep_their_names_and_kinds():
    full, empty = columns_of(Row, ROWS), through_parquet(columns_of(Row, ()))
    assert tuple(empty) == NAMES
    assert all(len(column) == 0 and column.dtype.kind == full[name].dtype.kind for name, column in empty.items())


def test_a_contrast_flattens_without_two_columns_of_one_name():
    """analyse drops the prefix of what is compared; the sides' names must not meet their groups' columns."""
    columns = columns_of(Contrast, ())
    shortened = {name.removeprefix("comparison_") for name in columns}
    assert len(shortened) == len(columns)
    assert {"a", "a_n", "a_mean_low", "b_sd", "welch_p", "welch_holm", "ratio_high", "hedges_g"} <= shortened
    assert {f"comparison_{name}" for name in columns_of(Comparison, ())} <= set(columns)


def test_csv_leaves_out_what_is_not_there_and_spreads_several_numbers():
    table = {"k": np.array([1.5, np.nan]), "of": np.array([[1, 2], [3, 4]]), "why": np.array(["", 'a, "b"'])}
    assert csv_of(table).decode() == 'k,of_0,of_1,why\n1.5,1,2,\n,3,4,"a, ""b"""\n'
