"""A medium of a user's own that fails: one line where it is used, and nothing elsewhere."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
HONEY = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "extending.md").read_text(), flags=re.DOTALL)[0]


@pytest.fixture
def called(tmp_path):
    """Run the command line in a copy of the sources whose medium honey has an edit."""
    for package in ("tasks", "pipeline"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))

    def call(old: str, new: str, *arguments: str) -> tuple[int, str]:
        assert HONEY.count(old) == 1
        (tmp_path / "tasks/world/honey.py").write_text(HONEY.replace(old, new))
        command = [sys.executable, "-m", "pipeline", *arguments]
        environment = {**os.environ, "PYTHONPATH": ""}
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
        return done.returncode, done.stderr

    return call


DESIGN = str(ROOT / "docs" / "design.json")


def test_a_medium_that_fails_is_one_line_where_it_is_used(called, tmp_path):
    simulate = ("simulate", DESIGN, "--environment", "honey", "--depth", "9")
    study = ("study", "--preset", "smoke", "--set", "target=honey")
    for old, new, command in (
        ("def law(", "def law((", study),
        ("links.y <", "links.height <", study),
        ("links.y <", "links.height <", simulate),
    ):
        code, said = called(old, new, *command)
        line = HONEY[: HONEY.index(old)].count("\n") + 1
        (last,) = [one for one in said.splitlines() if not one.startswith("compiling")]
        assert code == 2 and f"{tmp_path}/tasks/world/honey.py:{line}: " in last
    code, said = called("def law(", "def law((", "simulate", DESIGN, "--environment", "dry_land", "--depth", "9")
    assert code == 0 and "honey" not in said
