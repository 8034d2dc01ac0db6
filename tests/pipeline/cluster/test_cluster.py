"""The two clusters keep one contract; Ray's processes are pinned, closed to strangers, and gone when the study is."""

import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from marked_processes import started

from pipeline.cluster import Cluster, Done, Outcome, Spread, TaskFailed, Ticket, on_ray, ray_cluster, serial_cluster
from pipeline.errors import PuddleError

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module", autouse=True)
def sent_to_workers(local_ray: Cluster) -> None:
    """Let workers have the functions of this module, which they can't import. Ray itself is imported by the driver."""
    import ray

    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])


def address_of(_: Cluster) -> str:
    import ray

    return str(ray.get_runtime_context().gcs_address)


@pytest.fixture(params=["serial", "ray"])
def cluster(request: pytest.FixtureRequest):
    if request.param == "ray":
        yield request.getfixturevalue("local_ray")
    else:
        with serial_cluster() as serial:
            yield serial


def outcomes(cluster: Cluster) -> dict[Ticket, Outcome]:
    taken = {}
    while (done := cluster.next_done(timeout=60)) is not None:
        taken[done[0]] = done[1]
    return taken


def in_order(cluster: Cluster) -> list[Outcome]:
    return [outcome for _, outcome in sorted(outcomes(cluster).items(), key=lambda item: item[0].number)]


def only(cluster: Cluster) -> Outcome:
    (outcome,) = outcomes(cluster).values()
    return outcome


def wander(seed: int, steps: np.ndarray) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(3, steps.size)) @ np.outer(steps, steps)


def reciprocal(x: float) -> float:
    return 1 / x


def nested(items: list[float], scale: float) -> list[float]:
    return Spread(lambda x, scale: scale * reciprocal(x), scale)(items)


def test_the_same_results_serially_and_on_ray(local_ray):
    results = []
    with serial_cluster() as serial:
        for cluster in (serial, local_ray):
            shared = cluster.share(np.linspace(0, 1, 50))
            tickets = [cluster.submit(wander, seed, shared, name=f"wander {seed}") for seed in range(6)]
            by_ticket = outcomes(cluster)
            assert {ticket.name for ticket in by_ticket} == {f"wander {seed}" for seed in range(6)}
            results.append([by_ticket[ticket].result for ticket in tickets])
    assert all(np.array_equal(one, other) for one, other in zip(*results, strict=True))
    assert len({result.tobytes() for result in results[0]}) == 6


def test_a_failure_is_an_outcome_and_the_rest_goes_on(cluster):
    for x in (1.0, 0.0, 4.0):
        cluster.submit(reciprocal, x, name=f"reciprocal of {x}")
    first, failed, last = in_order(cluster)
    assert (first, last) == (Done(1.0), Done(0.25))
    assert isinstance(failed, TaskFailed) and isinstance(failed, PuddleError)
    assert str(failed) == "reciprocal of 0.0: ZeroDivisionError: float division by zero"
    assert isinstance(failed.__cause__, ZeroDivisionError)


def test_spread_keeps_the_order_of_its_items_and_its_failure_is_the_tasks(cluster):
    cluster.submit(nested, [1.0, 2.0, 4.0, 8.0], 16.0, n_cores=0)
    assert only(cluster) == Done([16.0, 8.0, 4.0, 2.0])
    cluster.submit(nested, [1.0, 0.0, 2.0], 1.0, n_cores=0, name="generation 7")
    failed = only(cluster)
    assert isinstance(failed, TaskFailed)
    assert str(failed).startswith("generation 7: ") and "ZeroDivisionError" in str(failed)


def test_spread_on_ray_uses_other_processes(local_ray):
    def pids() -> tuple[int, list[int]]:
        return os.getpid(), Spread(lambda _: os.getpid())(range(4))

    local_ray.submit(pids, n_cores=0)
    outer, inner = only(local_ray).result
    assert outer not in inner
    assert Spread(lambda _: os.getpid())(range(4)) == [os.getpid()] * 4  # the driver is no worker


def test_a_spread_within_every_core_does_not_wait_for_itself(local_ray):
    for _ in range(4):
        local_ray.submit(nested, [1.0, 2.0], 1.0, n_cores=1)
    assert in_order(local_ray) == [Done([1.0, 0.5])] * 4


@pytest.mark.parametrize(("dies", "n_attempts"), [(True, 2), (False, 1)])
def test_a_killed_worker_is_tried_again_once_and_an_exception_is_not(dies, n_attempts, local_ray, tmp_path):
    def fail(log: Path) -> None:
        with log.open("a") as file:
            file.write("tried\n")
        if dies:
            os._exit(1)
        raise ValueError("no")

    local_ray.submit(fail, tmp_path / "log", name="the failing one")
    local_ray.submit(reciprocal, 2.0)
    failed, done = in_order(local_ray)
    assert isinstance(failed, TaskFailed)
    assert "the failing one" in str(failed) and ("WorkerCrashedError" if dies else "ValueError: no") in str(failed)
    assert (tmp_path / "log").read_text() == "tried\n" * n_attempts
    assert done == Done(0.5)


def test_cancelled_calls_stop_and_give_nothing(local_ray, tmp_path):
    def write_when_told(path: Path) -> None:
        (path.parent / "started").touch()
        while not (path.parent / "cancelled").exists():
            time.sleep(0.02)
        time.sleep(1.0)
        path.touch()

    local_ray.submit(write_when_told, tmp_path / "done")
    assert local_ray.next_done(timeout=0) is None
    deadline = time.monotonic() + 30
    while not (tmp_path / "started").exists():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    local_ray.cancel_all()
    assert local_ray.next_done(timeout=None) is None
    (tmp_path / "cancelled").touch()
    time.sleep(2.0)
    assert not (tmp_path / "done").exists()
    local_ray.submit(reciprocal, 4.0)
    assert only(local_ray) == Done(0.25)


def test_a_worker_has_one_thread_in_every_library(local_ray):
    def threads() -> dict[str, int]:
        import numba
        import threadpoolctl
        import torch

        pools = {pool["filepath"]: pool["num_threads"] for pool in threadpoolctl.threadpool_info()}
        return pools | {"torch": torch.get_num_threads(), "numba": numba.get_num_threads()}

    local_ray.submit(threads)
    found = only(local_ray).result
    assert len(found) > 2  # numpy's BLAS is among them
    assert set(found.values()) == {1}, found


def test_a_stranger_without_the_token_is_refused(local_ray):
    token = Path(os.environ["RAY_AUTH_TOKEN_PATH"])
    assert token.stat().st_mode & 0o777 == 0o600
    assert token.parent.stat().st_mode & 0o777 == 0o700
    program = "import sys; from pipeline.cluster import ray_cluster; ray_cluster(sys.argv[1]).__enter__()"
    environment = os.environ | {"RAY_AUTH_TOKEN": "0" * 64}
    del environment["RAY_AUTH_TOKEN_PATH"]
    words = [sys.executable, "-c", program, address_of(local_ray)]
    refused = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=200)
    assert refused.returncode != 0
    assert "cannot use the Ray cluster at 127.0.0.1:" in refused.stderr and "RAY_AUTH_TOKEN" in refused.stderr


def test_an_existing_cluster_is_sent_the_packages(local_ray, tmp_path):
    """A driver elsewhere joins by address, behind a proxy, too; its workers import what it sent."""
    driver = """
import sys
from pipeline.cluster import ray_cluster
from pipeline.cluster.process import prepare_process
prepare_process()
def where():
    import pipeline.cluster, tasks.design.genes
    return pipeline.cluster.__file__, tasks.design.genes.__file__
with ray_cluster(sys.argv[1]) as cluster:
    cluster.submit(where)
    print(*cluster.next_done()[1].result, cluster.n_cores, sep="\\n", file=sys.stderr)
"""
    proxy = dict.fromkeys(("http_proxy", "https_proxy", "grpc_proxy"), "http://192.0.2.9:9")
    environment = os.environ | proxy | {"PYTHONPATH": os.pathsep.join(sys.path), "RAY_ADDRESS": "http://elsewhere:8265"}
    words = [sys.executable, "-c", driver, address_of(local_ray)]
    ran = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=200)
    assert ran.returncode == 0, ran.stderr
    ours, science, n_cores = ran.stderr.splitlines()
    assert "py_modules_files" in ours and "py_modules_files" in science
    assert float(n_cores) == 2.0


def test_workers_have_the_driver_s_environment_and_nothing_of_the_folder_where_a_user_works(tmp_path):
    """Under `uv run`, too: Ray looks for a process of that name, and would have each worker build the environment."""
    driver = """
import sys
from pipeline.cluster import ray_cluster
from pipeline.cluster.process import prepare_process
prepare_process()
with ray_cluster(n_workers=1) as cluster:
    cluster.submit(getattr, sys, "executable")
    assert cluster.next_done()[1].result == sys.executable
from ray._private.runtime_env.uv_runtime_env_hook import hook
assert hook({"working_dir": "/"})["py_executable"].startswith("uv run --no-sync")
"""
    for name in ("tasks.py", "pipeline.py"):
        (tmp_path / name).write_text("raise ImportError('this is a file of the user')")
    (tmp_path / "run").write_text('shift\n"$@"\nexit $?\n')  # for the shell, whose name and first word are uv's
    words = ["uv", "run", "--no-sync", sys.executable, "-P", "-c", driver]  # -P: as the script `puddle`
    options = {"executable": "/bin/sh", "cwd": tmp_path, "capture_output": True, "text": True, "timeout": 200}
    ran = subprocess.run(words, env=os.environ | {"RAY_ADDRESS": "http://elsewhere:8265"}, **options)
    assert ran.returncode == 0, ran.stderr


DIES = """
import psutil
from pipeline.cluster import ray_cluster
from pipeline.cluster.process import prepare_process
prepare_process()
def forever():
    while True: pass
with ray_cluster(n_workers=1) as cluster:
    cluster.submit(forever)
    cluster.next_done(timeout=1.0)
    servers = {process.name(): process for process in psutil.Process().children()}
    servers["gcs_server"].kill()
    cluster.next_done()
"""


def test_the_death_of_a_server_is_reported_at_once_and_leaves_no_process(tmp_path):
    with started([sys.executable, "-c", DIES], tmp_path / "log", dict(os.environ), cwd=ROOT) as driver:
        driver.wait_for(driver.ended, 180.0)
        assert "Ray on this machine died" in driver.said()


LOSES_ITS_RAYLET = """
import os, time
import psutil
from pipeline.cluster import ray_cluster
from pipeline.cluster.process import prepare_process
prepare_process()
with ray_cluster(n_workers=1) as cluster:
    print(os.environ["RAY_AUTH_TOKEN_PATH"], flush=True)
    cluster.submit(time.sleep, 600.0)
    [raylet] = [process for process in psutil.Process().children() if process.name() == "raylet"]
    while not any(child.name().startswith("python") for child in raylet.children()):
        time.sleep(0.01)
    raylet.kill()
"""


def test_a_worker_that_starts_while_its_raylet_is_killed_leaves_no_folder(tmp_path):
    with started([sys.executable, "-c", LOSES_ITS_RAYLET], tmp_path / "log", dict(os.environ), cwd=ROOT) as driver:
        driver.wait_for(driver.ended, 180.0)
        token = Path(driver.said().split()[0])
        assert token.name == "token" and not token.parent.exists()


LOSES_A_MACHINE = """
import os, sys, time
from pathlib import Path
from ray.cluster_utils import Cluster
from pipeline.cluster import ray_cluster
place = Path(sys.argv[1])
def square(number):
    (place / f"{number}-{os.getppid()}").touch()
    time.sleep(600 if number == 0 and len(list(place.iterdir())) == 1 else 0)
    return number**2
machines = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
lost = machines.add_node(num_cpus=1)
with ray_cluster(machines.address) as cluster:
    tickets = [cluster.submit(square, number) for number in range(3)]
    while not list(place.iterdir()):
        time.sleep(0.05)
    machines.remove_node(lost, allow_graceful=False)
    machines.add_node(num_cpus=1)
    results = dict(cluster.next_done() for _ in tickets)
print(*(results[ticket].result for ticket in tickets))
machines.shutdown()
"""

IMPATIENT = {
    "RAY_health_check_initial_delay_ms": "500",
    "RAY_health_check_period_ms": "500",
    "RAY_health_check_timeout_ms": "2000",
    "RAY_health_check_failure_threshold": "2",
}
"""Ray's environment variables with which it misses a machine within seconds, and not after a quarter of a minute."""


def test_another_machine_takes_over_the_calls_of_one_that_is_lost(tmp_path):
    environment = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")} | IMPATIENT
    words = [sys.executable, "-c", LOSES_A_MACHINE, str(tmp_path)]
    ran = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300)
    assert ran.stdout.splitlines()[-1:] == ["0 1 4"], ran.stdout + ran.stderr
    machines = [path.name.partition("-") for path in tmp_path.iterdir()]
    assert len({raylet for _, _, raylet in machines}) == 2  # the first call began on the machine that was lost
    assert sorted(number for number, _, _ in machines) == ["0", "0", "1", "2"]


@pytest.mark.parametrize("where", ["ray://head:10001", "nowhere", "host:99999", "http://host:80", "127.0.0.1:{free}"])
def test_what_is_no_address_of_a_cluster_is_refused_at_once(where: str):
    """``ray://`` is Ray Client's, which is not among what is installed."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))  # nothing answers there: Ray itself tries for minutes
        where = where.format(free=listener.getsockname()[1])
        begin = time.monotonic()
        with pytest.raises(PuddleError, match="expected host:port where one answers") as refused, ray_cluster(where):
            pass
    assert time.monotonic() - begin < 20.0
    assert where in str(refused.value) and "--address" in str(refused.value)


def test_no_workers_is_refused():
    with pytest.raises(PuddleError, match="workers: expected at least 1, got 0"), ray_cluster(n_workers=0):
        pass


def test_a_session_folder_goes_though_ray_still_writes_to_it(tmp_path: Path, monkeypatch):
    (folder := tmp_path / "ray").mkdir()
    still_writes = iter([True, True, False])

    def pause(seconds: float) -> None:
        if next(still_writes):
            (folder / "logs").mkdir(parents=True)

    monkeypatch.setattr(time, "sleep", pause)
    on_ray._remove(folder)
    assert not folder.exists()
