import numpy as np
import pytest

from tasks.residual import split_throws


def test_whole_throws_are_held_out():
    throw = np.random.default_rng(0).permutation(np.repeat(np.arange(50), 7))
    learned, validated = split_throws(throw, 0.1, seed=1)
    assert len(set(throw[validated])) == 5 and validated.sum() == 35
    assert (learned != validated).all() and set(throw[validated]).isdisjoint(throw[learned])
    assert set(throw[split_throws(throw, 0.1, seed=2)[1]]) != set(throw[validated])


@pytest.mark.parametrize("share", [0.01, 0.99])
def test_at_least_one_throw_is_held_out_and_not_all(share):
    learned, validated = split_throws(np.array([3, 9]), share, seed=0)
    assert learned.sum() == validated.sum() == 1
