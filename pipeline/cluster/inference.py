"""The inference service: one process for each GPU of a machine evaluates the networks of all its workers.

A worker steps robots and writes what networks read to shared memory; it waits until their outputs stand beside it.
Nothing is pickled and no message is sent in a step. The service begins whatever it is asked for, so a GPU does not wait
for one trial while another has work for it. Without a GPU it computes on a core.
"""

import functools
import math
import mmap
import os
import tempfile
import threading
import time
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import psutil

from pipeline.cluster.on_ray import in_ray_worker

if TYPE_CHECKING:
    from tasks.arrays import Float32
    from tasks.residual.served_ensemble import Layers, Predict, ServedEnsemble

_FOLDER = "/dev/shm" if Path("/dev/shm").is_dir() else None  # of files in memory, where there is one
_N_CONNECTIONS = 4  # of a worker; if there are more, the first is closed
_SECONDS_BETWEEN_CHECKS = 1.0  # of a worker that waits, whether the service is there [s]
_N_ATTEMPTS, _SECONDS_BETWEEN_ATTEMPTS = 10, 0.5  # to find a service, after the death of one
_IDLE_POLLS, _NAP = 2000, 1e-3  # after so many polls without work, a service sleeps between two [s]


class ServiceDied(RuntimeError):  # noqa: N818 (what happened)
    """The inference service died, and so did the one that took its place, or it did not start."""


class Exchange:
    """Memory that a worker shares with the service: inputs, outputs, and how many were asked for and answered.

    Each part has pages of its own, which a GPU locks.
    """

    def __init__(self, path: Path, n_rows: int, layers: "Layers") -> None:
        """Map a file, which may be removed then."""
        n_members, n_in, _ = layers[0][0].shape
        of_x, of_y = (n_members, n_rows, n_in), (n_members, n_rows, layers[-1][0].shape[2])
        first_y = mmap.PAGESIZE * (1 + math.ceil(4 * math.prod(of_x) / mmap.PAGESIZE))
        counts = np.memmap(path, np.int64, "r+", 0, (2,)).view(np.ndarray)
        self.asked, self.answered = counts[:1], counts[1:]
        self.x = np.memmap(path, np.float32, "r+", mmap.PAGESIZE, of_x).view(np.ndarray)
        self.y = np.memmap(path, np.float32, "r+", first_y, of_y).view(np.ndarray)


class Service:
    """Evaluates networks for the workers that are connected, until its process ends."""

    def __init__(self, device: int) -> None:
        """Start to serve on a thread; ``device`` is the number of the GPU."""
        self._device = device
        self._served: list[_Served] = []
        threading.Thread(target=self._serve, daemon=True).start()

    def connect(self, path: Path, n_rows: int, layers: "Layers", worker: int) -> int:
        """Serve the process of a number from now on; return the number of this one."""
        from tasks.residual.torch_networks import TorchNetworks

        exchange = Exchange(path, n_rows, layers)
        networks = TorchNetworks(layers, exchange.x, exchange.y, self._device)
        served = [one for one in self._served if one.exchange.asked[0] >= 0 and psutil.pid_exists(one.worker)]
        self._served = [*served, _Served(exchange, networks, worker)]
        return os.getpid()

    def _serve(self) -> None:
        n_idle = 0
        try:
            while True:
                worked = [one.advance() for one in self._served]
                n_idle = 0 if any(worked) else n_idle + 1
                time.sleep(_NAP if n_idle > _IDLE_POLLS else 0)
        except BaseException:  # such as of a GPU that fails: workers would wait for ever
            traceback.print_exc()
            os._exit(1)


@dataclass
class _Served:
    exchange: Exchange
    networks: Any
    worker: int  # number of its process
    begun: bool = False

    def advance(self) -> bool:
        """Begin what is asked for, or answer it where it is done; return whether there was work."""
        if self.begun and self.networks.done():
            self.exchange.answered[0] += 1
            self.begun = False
        elif not self.begun and self.exchange.asked[0] > self.exchange.answered[0]:
            self.networks.start()
            self.begun = True
        else:
            return self.begun
        return True


class _Connection:
    def __init__(self, ensemble: "ServedEnsemble", n_rows: int) -> None:
        self._layers, self._n_rows = ensemble.layers, n_rows
        self._open()

    def _open(self) -> None:
        with tempfile.NamedTemporaryFile(prefix="puddle-", dir=_FOLDER) as file:  # mapped by both when it is removed
            shared = Path(file.name), self._n_rows, self._layers
            self.exchange = Exchange(*shared)
            self.service = _call_service(*shared, os.getpid())

    def predict(self, observation: "Float32") -> "Float32":
        if not self._answers(observation):
            self._open()  # another takes its place
            if not self._answers(observation):
                raise ServiceDied(f"the inference service died twice, the last one as process {self.service}")
        return self.exchange.y

    def _answers(self, observation: "Float32") -> bool:
        """Wait for the outputs; return whether the service lives."""
        exchange = self.exchange
        exchange.x[:] = observation
        exchange.asked[0] += 1
        check = time.monotonic() + _SECONDS_BETWEEN_CHECKS
        while exchange.answered[0] < exchange.asked[0]:
            os.sched_yield()
            if time.monotonic() > check:
                if not psutil.pid_exists(self.service):
                    return False
                check = time.monotonic() + _SECONDS_BETWEEN_CHECKS
        return True


def _call_service(*arguments: Any) -> int:
    """Connect to this machine's service, which is started if there is none."""
    import ray
    from ray.exceptions import RayActorError, RayTaskError

    for _ in range(_N_ATTEMPTS):
        try:
            return int(ray.get(_service().connect.remote(*arguments)))
        except RayTaskError as error:
            raise error.cause from None
        except RayActorError:
            _service.cache_clear()
            time.sleep(_SECONDS_BETWEEN_ATTEMPTS)
    raise ServiceDied("the inference service did not start")


@functools.cache
def _service() -> Any:
    import ray
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    here = ray.get_runtime_context().get_node_id()
    n_gpus = sum(int(node["Resources"].get("GPU", 0)) for node in ray.nodes() if node["NodeID"] == here)
    device = os.getpid() % max(n_gpus, 1)
    return (
        ray.remote(Service)
        .options(
            name=f"inference-{here}-{device}",
            get_if_exists=True,
            num_cpus=0,
            scheduling_strategy=NodeAffinitySchedulingStrategy(here, soft=False),
        )
        .remote(device)
    )


_connections: dict[tuple[bytes, int], _Connection] = {}  # of this process, which is a worker


def connect(ensemble: "ServedEnsemble", n_rows: int) -> "Predict":
    """Return what evaluates a number of rows of each member: the service, or this process if it is no worker."""
    if not in_ray_worker():
        return _in_this_process(ensemble, n_rows)
    wanted = ensemble.key, n_rows
    if wanted not in _connections:
        if len(_connections) == _N_CONNECTIONS:
            _connections.pop(next(iter(_connections))).exchange.asked[0] = -1  # never more
        _connections[wanted] = _Connection(ensemble, n_rows)
    return _connections[wanted].predict


@functools.lru_cache(maxsize=1)
def _in_this_process(ensemble: "ServedEnsemble", n_rows: int) -> "Predict":
    from tasks.residual.torch_networks import TorchNetworks

    with tempfile.NamedTemporaryFile(dir=_FOLDER) as file:
        exchange = Exchange(Path(file.name), n_rows, ensemble.layers)
    return TorchNetworks(ensemble.layers, exchange.x, exchange.y)
