import numpy as np
import pytest

from tasks.bench.vision.throw_spans import throw_spans

MOVING = np.concatenate((np.linspace(0, 1, 30), np.ones(60), np.linspace(1, 0, 30)))
TO_REST, AGAIN = [*range(31)], [*range(90, 120)]


@pytest.mark.parametrize(
    ("seen", "x", "inside", "expected"),
    [
        # It begins where both tags are seen.
        ([1, 1, 1, 2, 1, 1, 2, 2], None, None, [[3, 4, 5, 6, 7]]),
        # A short gap is lost frames, 0.1 s from one sight to the next, and a long one ends the throw.
        ([2] * 5 + [0] * 5 + [2] * 5, None, None, [[*range(5), *range(10, 15)]]),
        ([2] * 5 + [0] * 7 + [2] * 5, None, None, [[*range(5)], [*range(12, 17)]]),
        # The zone ends a throw, and the next may begin.
        ([2] * 20, None, [1] * 8 + [0] * 4 + [1] * 8, [[*range(8)], [*range(12, 20)]]),
        # A bar at rest is not thrown again before it is covered.
        ([2] * 120, MOVING, None, [TO_REST]),
        ([2] * 89 + [1] + [2] * 30, MOVING, None, [TO_REST, AGAIN]),
        ([2] * 100, np.zeros(100), None, []),
        # A throw of few frames is left out.
        ([2] * 4, None, None, []),
        ([2] * 5, None, None, [[*range(5)]]),
        ([], None, None, []),
    ],
)
def test_throws(seen, x, inside, expected):
    n = len(seen)
    pose = np.zeros((n, 3))
    pose[:, 0] = np.arange(n) * 0.01 if x is None else x
    in_zone = np.ones(n, bool) if inside is None else np.array(inside, bool)
    throws = throw_spans(np.arange(n) / 60.0, np.array(seen), pose, in_zone, n_tags=2)
    assert [of.tolist() for of in throws] == expected
