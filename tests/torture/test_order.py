"""A result does not depend on the number of workers, the order in which they finish, or the size of batches."""

from __future__ import annotations

import numpy as np
import small_study

from pipeline.cluster import Cluster, Outcome, Ticket, serial_cluster
from pipeline.stages import STAGES
from pipeline.store.store import Store


class Shuffled:
    """A cluster that returns finished calls in random order: it collects all that have ended and picks one."""

    def __init__(self, cluster: Cluster, n_cores: float, rng: np.random.Generator) -> None:
        self.n_cores = n_cores
        self.out_of_order = 0
        self._cluster, self._rng = cluster, rng
        self._finished: list[tuple[Ticket, Outcome]] = []
        self.share, self.submit = cluster.share, cluster.submit

    def next_done(self, timeout: float | None = None) -> tuple[Ticket, Outcome] | None:
        while (done := self._cluster.next_done(timeout=0.5 if self._finished else None)) is not None:
            self._finished.append(done)
        if not self._finished:
            return None
        picked = self._finished.pop(self._rng.integers(len(self._finished)))
        self.out_of_order += any(ticket.number < picked[0].number for ticket, _ in self._finished)
        return picked


def test_the_same_bytes_in_whatever_order_work_ends(serial_run, torture, tmp_path):
    """One process computes up to eight work items at a time, in batches of any size, and returns them in random order.

    The workers are simulated: work items are computed one after the other in this process, and only the driver sees
    them end as if there were several workers; tests/pipeline/workflow has real ones.
    """
    everything, n_out_of_order = small_study.digests(serial_run[1]), 0
    expected = {of: found for of, found in everything.items() if not of.startswith("report/")}
    for number, rng in enumerate(torture.attempts(1, 100)):
        settings = small_study.one_trial(f"work.designs_per_batch={rng.integers(1, 6)}")
        with serial_cluster() as serial:
            cluster = Shuffled(serial, rng.choice([1, 2, 8]) if number else 8, rng)
            store = Store.open(tmp_path / str(number), create=True)
            found = small_study.run(settings, store, cluster, STAGES[:-1], say=print)  # the page names its versions
            assert small_study.digests(found) == expected
            n_out_of_order += cluster.out_of_order
    assert n_out_of_order
