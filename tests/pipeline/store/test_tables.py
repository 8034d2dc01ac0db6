"""Rows of frozen data as columns and as rows again, through Parquet, and as CSV."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.store.encoding import decode_table, encode_table
from pipeline.store.tables import columns_of, csv_of, rows_of
from tasks.analysis.against_paper import Row, against_paper
from tasks.analysis.attribution import Attribution, attribute
from tasks.analysis.comparison import Comparison, Contrast, sweep
from tasks.analysis.hallucination import Exploiter, rank_exploiters
from tasks.analysis.member_error import MemberError
from tasks.analysis.prediction import Regression, accuracy, members_ranges
from tasks.analysis.scores import Scores
from tasks.analysis.uncertainty import Estimate


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
    Sample(
        "y", 4, False, ("b", "d"), Estimate.missing("no"), None, "none", (2.0,), (2,), Group(None, 3), Group(1.0, 4)
    ),
)
NAMES = ("name", "n", "best", "side", "found", "found_low", "found_high", "found_reason", "p", "why")
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
        found=st.builds(Estimate, st.none() | numbers, st.none() | numbers, st.none() | numbers, reasons),
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
    assert columns["found_reason"].tolist() == ["", "no"] and columns["why"].tolist() == ["", "none"]


def test_without_rows_columns_keep_their_names_and_types():
    full, empty = columns_of(Sample, SAMPLES), through_parquet(columns_of(Sample, ()))
    assert tuple(empty) == NAMES
    assert all(len(column) == 0 and column.dtype.kind == full[name].dtype.kind for name, column in empty.items())


def test_a_contrast_has_the_columns_of_its_comparison_without_a_prefix():
    columns = set(columns_of(Contrast, ()))
    assert {"a", "a_n", "a_mean_low", "b_sd", "welch_p", "clustered_holm", "ratio_high", "hedges_g"} <= columns
    assert set(columns_of(Comparison, ())) < columns


def test_csv_leaves_out_what_is_missing_and_spreads_several_numbers():
    table = {"k": np.array([1.5, np.nan]), "of": np.array([[1, 2], [3, 4]]), "why": np.array(["", 'a, "b"'])}
    assert csv_of(table).decode() == 'k,of_0,of_1,why\n1.5,1,2,\n,3,4,"a, ""b"""\n'


@pytest.fixture(scope="module")
def scores() -> Scores:
    """Three arms at two depths; one trial diverged, and Dry Land has a single trial at 9 m."""
    rng = np.random.default_rng(3)
    grid = [(arm, d, n) for arm in ("true_slush", "dry_land", "residual_slush") for d in (1.0, 9.0) for n in range(4)]
    grid = [row for row in grid if row[:2] != ("dry_land", 9.0) or row[2] == 0]
    arm, depth, trial = (np.array(column) for column in zip(*grid, strict=True))
    zero_shot = rng.normal(5.0, 2.0, len(grid))
    zero_shot[1] = np.nan
    return Scores(arm, depth, trial, zero_shot + 1, zero_shot, zero_shot + 2)


@pytest.mark.parametrize("kind", [Regression, Contrast, Attribution, Row, Exploiter, MemberError])
def test_rows_of_the_analysis_come_back_from_parquet(kind, scores):
    rng = np.random.default_rng(4)
    predicted = rng.normal(size=(3, 20))
    fits = accuracy(predicted, np.full(20, 1.0), rng=rng)  # a constant: R is missing, with a reason
    true = np.r_[np.nan, predicted[0, 1:]]
    rows = {
        Regression: fits,
        Contrast: sweep(scores, rng=rng),
        Attribution: attribute(scores, rng=rng),
        Row: against_paper(scores, fits, members_ranges(predicted, true, rng=rng), rng=rng),
        Exploiter: rank_exploiters(predicted[1], true=true, disagreement=predicted.std(axis=0)),
        MemberError: [
            MemberError(0, "vx", "all", "dry", 0, None, None, None),
            MemberError(1, "vy", "all", "dry", 2, 0.1, 0.2, 0.0),
        ],
    }[kind]
    assert len(rows) > 1
    assert rows_of(kind, through_parquet(columns_of(kind, rows))) == list(rows)
