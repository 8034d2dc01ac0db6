"""What several test files share: one Ray cluster for the whole session, because starting one takes seconds; a robot."""

from collections.abc import Iterator

import numpy as np
import pytest

from pipeline.cluster import Cluster, ray_cluster
from tasks.design import N_LINKS, Designs


@pytest.fixture(scope="session")
def local_ray() -> Iterator[Cluster]:
    """Two cores of this machine as a Ray cluster. Tests that share it leave nothing running on it."""
    with ray_cluster("local", n_workers=2) as cluster:
        yield cluster


@pytest.fixture(scope="session")
def crane() -> Designs:
    """A design of the physical variant that one can work out by heart: links of 2 m, 140 × 35 mm on the bench.

    Part 1 is a cross at the origin (links 0, 1). At its top is joint 2: link 2 goes on upward and link 3 from its end
    to the right (part 2). At its right is joint 4: link 4 goes on to the right and link 5 from its end down (part 3).
    """
    return Designs(
        length_scale=np.full((1, N_LINKS), 2.0),
        parent=np.array([[-1, 0, 0, 2, 1, 4]]),
        parent_attachment=np.array([[0.0, 0.0, 1.0, 1.0, 1.0, 1.0]]),
        child_attachment=np.array([[0.0, 0.0, -1.0, -1.0, -1.0, -1.0]]),
        rest_angle=np.array([[0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, -np.pi / 2]]),
        phase=np.array([[0.0, 0.0, 0.0, 0.0, 1.0, 0.0]]),
        motion_range=np.array([[0.0, 0.2, 0.5, 0.2, 0.8, 0.2]]),
        motor_on=np.array([[False, False, True, False, True, False]]),
        frequency=np.array([0.2]),
    )
