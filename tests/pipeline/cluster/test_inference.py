"""The inference service: one for all workers, nothing left in memory, and another after its death."""

import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import psutil
import pytest
from small_study import digests, one_trial, run

from pipeline.cluster import connect, serial_cluster
from pipeline.cluster import inference as service
from pipeline.stages import STAGES
from pipeline.store.store import Store
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


def test_a_study_goes_on_where_the_service_dies(local_ray, ensemble, tmp_path, monkeypatch):
    """Another takes its place, also for workers that wait for it, and no number is another."""
    settings, stages = one_trial("work.networks=gpu", "grid.environments=[residual_slush]"), STAGES[:3]
    with serial_cluster() as serial:
        expected = run(settings, Store.open(tmp_path / "serial", create=True), serial, stages)
    local_ray.submit(ask, ensemble, 50)
    ((_, _, number),) = [outcome.result for outcome in results(local_ray, 1)]
    submit = local_ray.submit

    def kill_in_the_second_segment(*arguments, name="", **options):
        if name == "evolve residual_slush/1m/trial-0/segment-1":
            with suppress(psutil.NoSuchProcess):  # the segment is submitted again where the service took it along
                psutil.Process(number).kill()
        return submit(*arguments, name=name, **options)

    monkeypatch.setattr(local_ray, "submit", kill_in_the_second_segment)
    found = run(settings, Store.open(tmp_path / "store", create=True), local_ray, stages)
    assert not psutil.pid_exists(number)
    assert digests(found) == digests(expected)


def test_a_service_that_dies_again_fails_the_item(ensemble, monkeypatch):
    dead = subprocess.Popen(["true"])
    dead.wait()
    monkeypatch.setattr(service, "_call_service", lambda *_: dead.pid)
    with pytest.raises(service.ServiceDied, match=rf"died twice, the last one as process {dead.pid}"):
        service._Connection(ensemble, 5).predict(observations(5))
