"""Box2D's constants: squared tolerances make the same decisions as Box2D's square roots."""

import numpy as np
import pytest

from tasks.simulation.box2d import LINEAR_SLOP, LINEAR_SLOP_SQUARED, largest_square


@pytest.mark.parametrize("root", [LINEAR_SLOP, 0.3, 1.0, 7.0])
def test_a_square_is_compared_as_its_root_would_be(root: float) -> None:
    middle = np.array(root * root, np.float32).view(np.int32)
    squares = (middle + np.arange(-2000, 2000, dtype=np.int32)).view(np.float32)
    np.testing.assert_array_equal(squares <= np.float32(largest_square(root)), np.sqrt(squares) <= np.float32(root))


def test_the_slop_is_that_of_box2d() -> None:
    assert np.sqrt(np.float32(LINEAR_SLOP_SQUARED)) == np.float32(0.005)
