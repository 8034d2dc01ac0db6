"""A run contacts no other machine. In a network namespace, every packet that would leave the machine is counted.

A cluster also answers only its own members: it listens on its machines' addresses, so the token alone keeps others out.
"""

from __future__ import annotations

import collections
import json
import os
import secrets
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
import yaml
from containers import SMALL_MEMORY, environment_of, instructions, words_of
from fork_server import TINY

from pipeline.store.store import Store

ROOT = Path(__file__).parents[2]

QUIET = ("RAY_", "MLFLOW_", "PYTEST_", "CI", "GITHUB_", "GITLAB_", "JENKINS_", "BUILDKITE", "TRAVIS", "TEAMCITY_")
"""Prefixes of variables that are removed: where MLflow finds one of them it sends no telemetry anyway."""

ALONE = "ip link set lo up"
"""Commands that set up a machine without a network: it has the loopback alone."""
UNHEARD = f"""{ALONE}
ip link add out type veth peer name nowhere
echo 1 > /proc/sys/net/ipv6/conf/out/disable_ipv6  # IPv6 sends packets by itself
ip link set out up; ip link set nowhere up
ip address add 192.0.2.2/24 dev out; ip route add default via 192.0.2.1"""
"""Commands that set up a machine whose network accepts every packet and never answers."""


def on_a_machine(setup: str, *command: str, **changes: str) -> subprocess.CompletedProcess[str]:
    """Run a command in its own network namespace; the last line of its output counts the packets that would leave.

    Skips the test where the system has no network namespaces.
    """
    count = "awk '$1 == \"out:\" {print $11}' /proc/net/dev"  # packets sent
    script = f'set -e; {setup}\nset +e; "$@"; ended=$?; echo; {count}; exit $ended'
    environment = {name: value for name, value in os.environ.items() if not name.startswith(QUIET)}
    environment |= {"PYTHONPATH": str(ROOT), "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    words = ["unshare", "--net", "--map-root-user", "sh", "-c"]

    def answer(script: str, *arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*words, script, *arguments], env=environment | changes, capture_output=True, text=True, timeout=280
        )

    try:
        tried = answer(f"set -e; {setup}")
    except FileNotFoundError:
        pytest.skip("no unshare here")
    if tried.returncode != 0:
        pytest.skip(f"cannot set up such a network here: {tried.stderr.strip().splitlines()[-1:]}")
    return answer(script, "sh", *command)


def n_packets(ran: subprocess.CompletedProcess[str]) -> int:
    return int(ran.stdout.split()[-1])


@pytest.mark.parametrize(
    ("setup", "refusal"), [(ALONE, "Network is unreachable"), (UNHEARD, "timed out")], ids=["alone", "unheard"]
)
def test_a_study_needs_no_network_and_sends_no_packet(setup, refusal, torture, tmp_path: Path):
    torture.times(1, 1)
    if setup is ALONE and not torture.large:
        pytest.skip("only with --torture: where no packet is answered a study works, too")
    called = on_a_machine(
        setup, sys.executable, "-c", "import socket; socket.create_connection(('198.51.100.1', 9), 1)"
    )
    assert refusal in called.stderr
    (tmp_path / "tiny.yaml").write_text(yaml.safe_dump(TINY))
    study = [sys.executable, "-m", "pipeline", "study" if torture.large else "collect", "--workers", "1"]
    ran = on_a_machine(setup, *study, "--settings", f"{tmp_path}/tiny.yaml", "--store", f"{tmp_path}/store")
    assert ran.returncode == 0, ran.stderr
    assert "MLflow" not in ran.stderr
    if setup is UNHEARD:
        assert n_packets(called) > 0
        assert n_packets(ran) == 0
        torture.note("no packet left the machine")


HEAD, WORKER = "192.0.2.2", "192.0.2.3"
"""Addresses of the two machines of a cluster."""


def test_the_nodes_of_a_cluster_send_no_packet_and_refuse_a_stranger(torture, short_folder: Path):
    """By default Ray sends usage statistics and asks the metadata servers of three clouds."""
    torture.times(1, 1)
    of_head, of_worker = (f"--node-ip-address={ip} --temp-dir={short_folder / ip}" for ip in (HEAD, WORKER))
    head = words_of("head", {"--block": of_head, **SMALL_MEMORY})
    worker = words_of("worker", {"--block": of_worker, "head:6379": f"{HEAD}:6379", **SMALL_MEMORY})
    run_of_image = next(line for line in instructions("RUN") if "ray_bootstrap_config" in line)
    nodes = f"{run_of_image}; {' '.join(head)} && {' '.join(worker)}"
    environment = environment_of("head", {"RAY_AUTH_TOKEN_PATH": str(short_folder / "token")})
    (short_folder / "token").write_text(secrets.token_hex(32))
    script = f"{nodes} && sleep 5 && python {Path(__file__).with_name('stranger.py')}"
    machines = f"{UNHEARD}; ip address add {WORKER}/24 dev out"
    try:
        ran = on_a_machine(machines, "sh", "-c", script, **environment, HOME=str(short_folder))
    finally:  # `ray stop` would end every Ray on this machine, including those of other tests
        for process in psutil.process_iter(["cmdline"]):
            if any(str(short_folder) in word for word in process.info["cmdline"] or ()):
                process.kill()
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert n_packets(ran) == 0
    asked = json.loads(ran.stdout.splitlines()[-3])
    answers = collections.Counter((one["process"], *sorted(one["answers"])) for one in asked)
    assert answers == {
        ("gcs_server", 12, 12, 16): 1,
        ("raylet", 12, 12, 16): 4,  # two on each node
        ("ray::RuntimeEnvAgent", 401): 2,
    }
    torture.note(f"{len(asked)} sockets of two nodes refused a stranger")


PAGES = """
import re, subprocess, sys, time, urllib.request

def page(path, **said):
    json = {"Content-Type": "application/json"}
    asked = urllib.request.Request(f"http://127.0.0.1:5000/{path}", headers=json, **said)
    with urllib.request.urlopen(asked, timeout=60) as answer:
        return answer.read().decode()

server = subprocess.Popen([sys.executable, "-m", "pipeline", "ui", "--store", sys.argv[1], "--port", "5000"])
try:
    end = time.monotonic() + 120
    while True:
        try:
            page("health")
            break
        except OSError:
            assert server.poll() is None and time.monotonic() < end, "no server"
            time.sleep(0.2)
    parts = re.findall(r'(?:src|href)="(?:\\./)?(static-files/[^"]+)"', page(""))
    assert len(parts) > 2, parts
    for path in parts:
        if not path.endswith(".ico"):
            page(path)
    page("ajax-api/2.0/mlflow/experiments/search", data=b'{"max_results": 5}')
    page("ajax-api/2.0/mlflow/runs/search", data=b'{"experiment_ids": ["0"]}')
    page("ajax-api/3.0/mlflow/ui-telemetry")
    time.sleep(1)
finally:
    server.terminate()
    server.wait(60)
print("all pages loaded")
"""
"""The requests that a browser sends to MLflow's server; one of them asks for its telemetry settings."""


def test_the_ui_of_a_store_sends_no_packet(torture, tmp_path: Path):
    torture.times(1, 1)
    Store.open(tmp_path / "store", create=True)
    (tmp_path / "store" / "mlflow.db").touch()  # the server fills it
    ran = on_a_machine(UNHEARD, sys.executable, "-c", PAGES, str(tmp_path / "store"))
    assert "all pages loaded" in ran.stdout, ran.stdout + ran.stderr
    assert n_packets(ran) == 0
