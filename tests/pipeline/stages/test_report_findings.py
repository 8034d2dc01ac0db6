"""What the page shows is what the analysis found: tables are undone without loss."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.stages.report_findings import rows_of
from pipeline.store.tables import columns_of
from tasks.analysis import (
    Attribution,
    Contrast,
    Exploiter,
    MemberError,
    Regression,
    Row,
    Scores,
    accuracy,
    against_paper,
    attribute,
    members_ranges,
    rank_exploiters,
    sweep,
)


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
def test_columns_become_the_same_rows_again(kind, scores):
    rng = np.random.default_rng(4)
    predicted = rng.normal(size=(3, 20))
    fits = accuracy(predicted, np.full(20, 1.0), rng=rng)  # constant: R has a reason in its place
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
    assert rows_of(kind, columns_of(kind, rows)) == list(rows)
