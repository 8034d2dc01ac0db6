import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tasks.analysis.sample import draw_over_generations, spread_evenly


@given(st.integers(0, 5000), st.integers(1, 40))
def test_shares_add_up_and_differ_by_no_more_than_one(n_designs, n_trials):
    shares = spread_evenly(n_designs, n_trials)
    assert sum(shares) == n_designs and len(shares) == n_trials and max(shares) - min(shares) <= 1
    assert set(spread_evenly(2376, 20)) == {118, 119}  # the paper's


@given(st.integers(0, 300), st.integers(0, 2**32))
def test_no_design_is_drawn_twice(n_designs, seed):
    generation = np.repeat(np.arange(20), 10)
    drawn = draw_over_generations(generation, n_designs, np.random.default_rng(seed))
    assert len(drawn) == min(n_designs, 200)
    assert (np.diff(drawn) > 0).all()


def test_every_generation_is_as_likely_however_many_designs_it_has():
    """One generation of 900 and nine of 100 give a draw each with probability 1/10: 1000 draws, within 4 deviations."""
    generation = np.concatenate((np.zeros(900, int), np.repeat(np.arange(1, 10), 100)))
    rng = np.random.default_rng(1)
    drawn = np.concatenate([draw_over_generations(generation, 1, rng) for _ in range(1000)])
    assert np.mean(generation[drawn] == 0) == pytest.approx(0.1, abs=4 * np.sqrt(0.1 * 0.9 / 1000))
