"""The inference service: one for all workers, nothing left in memory, and another after its death."""

import os
import sys
from pathlib import Path

import numpy as np
import psutil
import pytest

from pipeline.cluster import Done, TaskFailed, connect
from pipeline.cluster import inference as service
from tasks.residual.ensemble import Ensemble
from tasks.residual.served_ensemble import ServedEnsemble
from tests.tasks.residual.test_ensemble import ARCHITECTURE, members, observations


@pytest.fixture(scope="module", autouse=True)
def sent_to_workers(local_ray):
    """Let workers have the functions of this module, which they can't import."""
    import ray

    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])


@pytest.fixture(scope="module")
def ensemble():
    local = Ensemble.from_members(members(ARCHITECTURE)[1])
    return ServedEnsemble(local.weights, local.biases, local.form, connect)


def ask(ensemble, n_rows):
    """The outputs, and the processes of the worker and the service."""
    predicted = ensemble.predict(observations(n_rows)).copy()
    return predicted, os.getpid(), service._connections[ensemble.key, n_rows].service


def results(cluster, n):
    return [cluster.next_done(timeout=60)[1] for _ in range(n)]


def test_workers_share_a_service_that_gives_what_a_process_computes_itself(local_ray, ensemble):
    before = set(Path(service._FOLDER).glob("puddle-*"))
    for n_rows in (100, 30, 100, 7, 12, 13, 100):  # more than the connections that a worker has
        for _ in range(2):
            local_ray.submit(ask, ensemble, n_rows)
        found = [outcome.result for outcome in results(local_ray, 2)]
        for predicted, _, _ in found:
            np.testing.assert_array_equal(predicted, ensemble.predict(observations(n_rows)))
        assert len({number for _, _, number in found}) == 1
        assert found[0][2] not in {os.getpid(), *(number for _, number, _ in found)}
    assert set(Path(service._FOLDER).glob("puddle-*")) == before


def test_after_its_death_a_call_fails_and_the_next_one_finds_another(local_ray, ensemble):
    local_ray.submit(ask, ensemble, 50)
    (first,) = results(local_ray, 1)
    psutil.Process(first.result[2]).kill()
    for _ in range(4):
        local_ray.submit(ask, ensemble, 50)
    outcomes = results(local_ray, 4)
    failed = [outcome for outcome in outcomes if isinstance(outcome, TaskFailed)]
    assert not [outcome for outcome in map(str, failed) if "ServiceDied: the inference service, process" not in outcome]
    assert len(failed) <= 2  # one of each worker that was connected
    again = [outcome.result for outcome in outcomes if isinstance(outcome, Done)]
    assert {number for _, _, number in again} != {first.result[2]}
    np.testing.assert_array_equal(again[-1][0], first.result[0])
