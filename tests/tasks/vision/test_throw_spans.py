"""Where throws begin and end."""

import numpy as np
import pytest

from tasks.vision.throw_spans import throw_spans


def spans(seen, x=None, inside=None, n_tags=2, rate=60.0):
    n = len(seen)
    pose = np.zeros((n, 3))
    pose[:, 0] = np.arange(n) * 0.01 if x is None else x
    found = throw_spans(
        np.arange(n) / rate,
        np.array(seen),
        pose,
        np.ones(n, bool) if inside is None else np.array(inside, bool),
        n_tags=n_tags,
    )
    return [of.tolist() for of in found]


def test_a_throw_begins_where_all_tags_are_seen():
    assert spans([1, 1, 1, 2, 1, 1, 2, 2]) == [[3, 4, 5, 6, 7]]


def test_a_short_gap_is_lost_frames_and_a_long_one_ends_the_throw():
    assert spans([2] * 5 + [0] * 5 + [2] * 5) == [[*range(5), *range(10, 15)]]  # 0.1 s from one sight to the next
    assert spans([2] * 5 + [0] * 7 + [2] * 5) == [[*range(5)], [*range(12, 17)]]


def test_the_zone_ends_a_throw_and_a_covered_tag_allows_the_next():
    assert spans([2] * 20, inside=[1] * 8 + [0] * 4 + [1] * 8) == [[*range(8)], [*range(12, 20)]]


def test_a_bar_at_rest_ends_its_throw_and_is_not_thrown_again_before_it_is_covered():
    moving = np.concatenate((np.linspace(0, 1, 30), np.ones(60), np.linspace(1, 0, 30)))
    (first,) = spans([2] * 120, x=moving)
    assert first[0] == 0 and 28 <= first[-1] <= 30
    covered = [2] * 89 + [1] + [2] * 30
    again = spans(covered, x=moving)
    assert len(again) == 2 and again[1][0] == 90


def test_a_throw_of_few_frames_is_left_out():
    assert spans([2] * 4) == [] and spans([2] * 5) == [[*range(5)]]
    assert spans([]) == []


@pytest.mark.parametrize("n_tags", [1, 2])
def test_a_bar_that_never_moves_is_no_throw(n_tags):
    assert spans([n_tags] * 100, x=np.zeros(100), n_tags=n_tags) == []
