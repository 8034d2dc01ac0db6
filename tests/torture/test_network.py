"""Whom a run calls: nobody. In a network namespace every packet is counted that would have left the machine."""

from __future__ import annotations

import os
import secrets
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
import yaml
from containers import SMALL_MEMORY, environment_of, instructions, words_of
from nursery import TINY

ROOT = Path(__file__).parents[2]

ALONE = "ip link set lo up"
"""A machine without network: the loopback is all there is."""
UNHEARD = f"""{ALONE}
ip link add out type veth peer name nowhere
echo 1 > /proc/sys/net/ipv6/conf/out/disable_ipv6  # which speaks by itself
ip link set out up; ip link set nowhere up
ip address add 192.0.2.2/24 dev out; ip route add default via 192.0.2.1"""
"""A machine whose network takes what is sent, and never answers."""


def on_a_machine(setup: str, *command: str, **changes: str) -> subprocess.CompletedProcess[str]:
    """Run in a network namespace of its own; the answer's last line counts the packets that would have left it.

    Skips where the system has no such thing.
    """
    count = "awk '$1 == \"out:\" {print $11}' /proc/net/dev"  # those it has sent
    script = f'set -e; {setup}\nset +e; "$@"; ended=$?; echo; {count}; exit $ended'
    environment = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
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
        pytest.skip(f"no such network to be had here: {tried.stderr.strip().splitlines()[-1:]}")
    return answer(script, "sh", *command)


def n_packets(ran: subprocess.CompletedProcess[str]) -> int:
    return int(ran.stdout.split()[-1])


@pytest.mark.parametrize(
    ("setup", "refusal"), [(ALONE, "Network is unreachable"), (UNHEARD, "timed out")], ids=["alone", "unheard"]
)
def test_a_study_completes_where_nobody_answers_and_calls_nobody(setup, refusal, torture, tmp_path: Path):
    torture.times(1, 1)
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
        torture.note("not a packet left the machine")


def test_the_head_of_a_cluster_calls_nobody(torture, short_folder: Path):
    """Ray itself would: its makers, and the metadata servers of three clouds."""
    torture.times(1, 1)
    here = f"--port=6379 --node-ip-address=127.0.0.1 --temp-dir={short_folder / 'ray'}"
    head = words_of("head", {"--block": here, "--port=6379": "--log-style=record", **SMALL_MEMORY})
    run_of_image = next(line for line in instructions("RUN") if "ray_bootstrap_config" in line)
    script = f'{run_of_image}; mkdir "$HOME/ray"; {" ".join(head)} && sleep 10'
    environment = environment_of("head", {"RAY_AUTH_TOKEN_PATH": str(short_folder / "token")})
    (short_folder / "token").write_text(secrets.token_hex(32))
    try:
        ran = on_a_machine(UNHEARD, "sh", "-c", script, **environment, HOME=str(short_folder))
    finally:  # not by `ray stop`, which ends every Ray of this machine, those of other tests too
        for process in psutil.process_iter(["cmdline"]):
            if any(str(short_folder) in word for word in process.info["cmdline"] or ()):
                process.kill()
    assert "Ray runtime started" in ran.stdout, ran.stderr
    assert n_packets(ran) == 0
