"""Rows of frozen data as columns and as rows again, through Parquet, and as CSV."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.store.encoding import decode_table, encode_table
from pipeline.store.tables import columns_of, csv_of, described, rows_of
from tasks.analysis.estimates import MISSING, Estimate
from tasks.analysis.tables import ANALYSES


@dataclass(frozen=True)
class Group:
    mean: float | None
    size: int


@dataclass(frozen=True)
class Sample:
    name: str
    n: int
    best: bool
    side: Literal["a", "b"]
    found: Estimate
    p: float | None
    why: str | None
    group: Group


SAMPLES = (
    Sample("x", 3, True, "a", Estimate(1.5, 1.0, 2.0), 0.25, None, Group(0.5, 1)),
    Sample("y", 4, False, "b", MISSING, None, "none", Group(None, 3)),
)
NAMES = ("name", "n", "best", "side", "found", "found_low", "found_high", "p", "why", "group_mean", "group_size")

numbers, integers = st.floats(allow_nan=False), st.integers(-(2**63), 2**63 - 1)
# numpy drops NULs at the end of a text, and surrogates are not Unicode.
texts = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=8)
reasons, groups = st.none() | texts.filter(bool), st.builds(Group, st.none() | numbers, integers)


estimates = st.builds(Estimate, st.none() | numbers, st.none() | numbers, st.none() | numbers)
samples = st.builds(
    Sample, texts, integers, st.booleans(), st.sampled_from("ab"), estimates, st.none() | numbers, reasons, groups
)


def through_parquet(columns):
    return decode_table(encode_table(columns, schema="t", version=1), schema="t", version=1, source="t")


@given(rows=st.lists(samples, max_size=5))
def test_rows_come_back_from_parquet(rows):
    assert rows_of(Sample, through_parquet(columns_of(Sample, rows))) == rows


def test_columns_have_the_names_and_types_that_parquet_holds_with_rows_and_without():
    columns, empty = (through_parquet(columns_of(Sample, rows)) for rows in (SAMPLES, ()))
    assert tuple(columns) == tuple(empty) == NAMES
    assert all(len(column) == 0 and column.dtype.kind == columns[name].dtype.kind for name, column in empty.items())
    assert columns["side"].tolist() == ["a", "b"]
    assert columns["found"][0] == 1.5 and np.isnan([columns[n][1] for n in ("found", "found_low", "p")]).all()
    assert columns["why"].tolist() == ["", "none"]


def test_csv_leaves_out_what_is_missing_and_spreads_several_numbers():
    table = {"k": np.array([1.5, np.nan]), "of": np.array([[1, 2], [3, 4]]), "why": np.array(["", 'a, "b"'])}
    assert csv_of(table).decode() == 'k,of_0,of_1,why\n1.5,1,2,\n,3,4,"a, ""b"""\n'


@pytest.mark.parametrize("one", ANALYSES.values(), ids=lambda one: one.name)
def test_every_analysis_has_columns_of_different_names(one):
    empty = columns_of(one.row, ())
    assert empty and rows_of(one.row, through_parquet(empty)) == []
    assert described(one.row).keys() == empty.keys()
