"""What a shell allows too little of, or has lost, is named in one line, before anything is started."""

import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.cluster import process
from pipeline.errors import PuddleError

PUDDLE = f"PYTHONPATH={Path(__file__).parents[3]} {sys.executable} -m pipeline"


@pytest.mark.parametrize(
    ("script", "expected"),
    [
        (
            "ulimit -v 3000000; {} study --preset smoke --workers 0",
            "address space (ulimit -v): expected at least 4.5 GB",
        ),
        (
            "ulimit -u 90; {} study --preset smoke --workers 1",
            "threads (ulimit -u, or the container's): expected at least",
        ),
        ("PYTHONOPTIMIZE=2 {} studies", "PYTHONOPTIMIZE=2"),
        ("mkdir gone; cd gone; rmdir ../gone; {} studies", "the working folder: No such file"),
    ],
)
def test_a_limit_is_one_line(script, expected, tmp_path):
    command = script.format(f"env {PUDDLE}")
    done = subprocess.run(["bash", "-c", command], cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1), done.stderr
    assert expected in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_container_that_allows_few_processes(tmp_path, monkeypatch):
    monkeypatch.setattr(process, "_CGROUP", tmp_path)
    (tmp_path / "pids.current").write_text("3\n")
    for most in ("max", "5000"):
        (tmp_path / "pids.max").write_text(f"{most}\n")
        process.check_limits(1)
    (tmp_path / "pids.max").write_text("100\n")
    process.check_limits(0)
    with pytest.raises(PuddleError, match=r"got 97\."):
        process.check_limits(1)
