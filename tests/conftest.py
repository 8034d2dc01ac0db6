"""What several test files share: one Ray cluster for the whole session, because starting one takes seconds."""

from collections.abc import Iterator

import pytest

from pipeline.cluster import Cluster, ray_cluster


@pytest.fixture(scope="session")
def local_ray() -> Iterator[Cluster]:
    """Two cores of this machine as a Ray cluster. Tests that share it leave nothing running on it."""
    with ray_cluster("local", n_workers=2) as cluster:
        yield cluster
