"""Signals wait for what must not be cut in two, but not for ever; libraries find one thread and no display."""

import importlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import typer

from pipeline.cluster import process
from pipeline.cluster.process import number_of_cores, prepare_process, signals_unwind
from pipeline.commands.terminal import interruptible

ROOT = Path(__file__).parents[3]


def test_a_signal_within_what_bears_no_exception_ends_the_process():
    program = """
import time
from pipeline.cluster.process import ended_by_signals
with ended_by_signals("why"):
    print("held", flush=True)
    while True:
        time.sleep(0.01)
"""
    child = subprocess.Popen(
        [sys.executable, "-c", program], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert child.stdout.readline() == "held\n"
    child.send_signal(signal.SIGTERM)
    _, said = child.communicate(timeout=60)
    assert (child.returncode, said) == (128 + signal.SIGTERM, "\nwhy\n")


def test_the_environment_of_libraries_is_prepared(monkeypatch):
    monkeypatch.setattr(os, "environ", {"MPLBACKEND": "module://matplotlib_inline", "no_proxy": "example.org"})
    prepare_process()
    assert os.environ["MPLBACKEND"] == "agg" and os.environ["OMP_NUM_THREADS"] == "1"
    assert os.environ["no_proxy"] == "example.org,localhost,127.0.0.1,::1"
    assert os.environ["NO_PROXY"] == "localhost,127.0.0.1,::1"


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="Linux's")
@pytest.mark.parametrize(
    ("files", "n_cores"),
    [
        ({"cpu.max": "50000 100000\n"}, 1),
        ({"cpu.max": "350000 100000\n"}, 3),
        ({"cpu.max": "max 100000\n"}, 8),
        ({"cpu/cpu.cfs_quota_us": "50000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 1),
        ({"cpu/cpu.cfs_quota_us": "350000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 3),
        ({"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, 8),
        ({}, 8),
    ],
)
def test_cores_are_those_of_the_affinity_and_the_quota(files, n_cores, monkeypatch, tmp_path):
    (tmp_path / "cpu").mkdir()
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(process, "_CGROUP", tmp_path)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(8))
    assert number_of_cores() == n_cores
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(1))
    assert number_of_cores() == 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_whoever_stops_a_command_is_told_how_it_goes_on(number, capsys, monkeypatch, tmp_path):
    """The signal meets an import, for whose end it waits: libraries swallow exceptions there."""
    (tmp_path / "stopped.py").write_text(f"import os, time\nos.kill(os.getpid(), {number:d})\ntime.sleep(0.1)\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "stopped", raising=False)
    usual = signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL
    before = signal.signal(number, usual)  # whoever runs the tests may ignore it
    try:
        with pytest.raises((SystemExit, typer.Exit)) as ended, interruptible(), signals_unwind():
            importlib.import_module("stopped")
            time.sleep(1)
    finally:
        signal.signal(number, before)
    assert "stopped" in sys.modules
    assert (ended.value.code if isinstance(ended.value, SystemExit) else ended.value.exit_code) == 128 + number
    assert "the same command resumes" in capsys.readouterr().err


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_is_ignored_stays_so(number):
    """`nohup puddle study &` outlives its terminal; Ray, which takes signals without a question, changes nothing."""
    before = signal.signal(number, signal.SIG_IGN)
    try:
        with signals_unwind() as take_back:
            assert signal.getsignal(number) == signal.SIG_IGN
            signal.signal(number, signal.SIG_DFL)
            take_back()
            os.kill(os.getpid(), number)
        assert signal.getsignal(number) == signal.SIG_IGN
    finally:
        signal.signal(number, before)
