"""Rows of frozen data as columns and as rows again, through Parquet, and as CSV."""

from dataclasses import dataclass, field
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
    side: tuple[Literal["a", "b"], str]
    found: Estimate
    p: float | None
    why: str | None
    by_member: tuple[float, ...]
    counts: tuple[int, ...]
    group: Group
    flat: Group = field(metadata={"prefix": False})


SAMPLES = (
    Sample("x", 3, True, ("a", "c"), Estimate(1.5, 1.0, 2.0), 0.25, None, (1.0,), (1,), Group(0.5, 1), Group(0.5, 2)),
    Sample("y", 4, False, ("b", "d"), MISSING, None, "none", (2.0,), (2,), Group(None, 3), Group(1.0, 4)),
)
NAMES = ("name", "n", "best", "side", "found", "found_low", "found_high", "p", "why")
NAMES += ("by_member", "counts", "group_mean", "group_size", "mean", "size")

numbers, integers = st.floats(allow_nan=False), st.integers(-(2**63), 2**63 - 1)
# numpy drops NULs at the end of a text, and surrogates are not Unicode.
texts = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=8)
reasons, groups = st.none() | texts.filter(bool), st.builds(Group, st.none() | numbers, integers)


def samples(width):
    return st.builds(
        Sample,
        name=texts,
        n=integers,
        best=st.booleans(),
        side=st.tuples(st.sampled_from("ab"), texts.filter(lambda name: "/" not in name)),
        found=st.builds(Estimate, st.none() | numbers, st.none() | numbers, st.none() | numbers),
        p=st.none() | numbers,
        why=reasons,
        by_member=st.tuples(*[numbers] * width),
        counts=st.tuples(*[integers] * width),
        group=groups,
        flat=groups,
    )


def through_parquet(columns):
    return decode_table(encode_table(columns, schema="t", version=1, producer=""), schema="t", version=1, source="t")


@given(rows=st.integers(1, 3).flatmap(lambda width: st.lists(samples(width), max_size=5)))
def test_rows_come_back_from_parquet(rows):
    assert rows_of(Sample, through_parquet(columns_of(Sample, rows))) == rows


def test_columns_have_the_names_and_types_that_parquet_holds():
    columns = through_parquet(columns_of(Sample, SAMPLES))
    assert tuple(columns) == NAMES
    assert columns["side"].tolist() == ["a/c", "b/d"]
    assert columns["found"][0] == 1.5 and np.isnan([columns[n][1] for n in ("found", "found_low", "p")]).all()
    assert columns["why"].tolist() == ["", "none"]


def test_without_rows_columns_keep_their_names_and_types():
    full, empty = columns_of(Sample, SAMPLES), through_parquet(columns_of(Sample, ()))
    assert tuple(empty) == NAMES
    assert all(len(column) == 0 and column.dtype.kind == full[name].dtype.kind for name, column in empty.items())


def test_csv_leaves_out_what_is_missing_and_spreads_several_numbers():
    table = {"k": np.array([1.5, np.nan]), "of": np.array([[1, 2], [3, 4]]), "why": np.array(["", 'a, "b"'])}
    assert csv_of(table).decode() == 'k,of_0,of_1,why\n1.5,1,2,\n,3,4,"a, ""b"""\n'


@pytest.mark.parametrize("one", ANALYSES.values(), ids=lambda one: one.name)
def test_every_analysis_has_columns_of_different_names(one):
    empty = columns_of(one.row, ())
    assert empty and rows_of(one.row, through_parquet(empty)) == []
    assert described(one.row).keys() == empty.keys()


def test_columns_with_the_same_name_are_refused():
    @dataclass(frozen=True)
    class Twice:
        found: Estimate
        found_low: float

    with pytest.raises(ValueError, match="found_low"):
        columns_of(Twice, ())
