import math

import numpy as np
import pytest

from tasks.residual import STATE, error_rows


def table(predicted, true, speed):
    return {(row.component, row.band): row for row in error_rows(predicted, true, speed)}


def test_figures_of_a_worked_example():
    true = np.zeros((4, 6), np.float32)
    true[:, 3] = [1, 2, 3, 6]
    error = np.zeros((4, 6), np.float32)
    error[:, 3] = [0.5, -0.5, 1, 0]
    rows = table(true + error, true, np.array([0.1, 0.2, 5.0, 50.0]))

    row = rows["vx", "all"]  # mean of squares 12.5, variance 12.5 - 3² = 3.5, squared error (¼ + ¼ + 1) / 4 = 3/8
    assert row.n_rows == 4
    assert row.rmse == pytest.approx(math.sqrt(3 / 8))
    assert row.bias == pytest.approx(0.25)
    assert row.relative_error == pytest.approx(math.sqrt(3 / 8 / 12.5))
    assert row.r2 == pytest.approx(1 - 3 / 8 / 3.5)

    slow = rows["vx", "< 0.5"]
    assert (slow.n_rows, slow.rmse, slow.bias, slow.r2) == (2, 0.5, 0.0, 0.0)
    assert rows["vx", "2-10"].bias == 1.0 and math.isnan(rows["vx", "2-10"].r2)
    assert rows["vx", "0.5-2"].n_rows == 0 and math.isnan(rows["vx", "0.5-2"].rmse)
    assert rows["vy", "all"].rmse == 0.0 and math.isnan(rows["vy", "all"].relative_error)


def test_every_row_is_in_one_band():
    speed = np.array([0.0, 0.49, 0.5, 1.99, 2.0, 9.99, 10.0, 1e9])
    rows = table(np.zeros((8, 6)), np.ones((8, 6)), speed)
    for component in STATE:
        n_rows = [rows[component, band].n_rows for band in ("< 0.5", "0.5-2", "2-10", "> 10")]
        assert n_rows == [2, 2, 2, 2]
        assert rows[component, "all"].n_rows == 8
