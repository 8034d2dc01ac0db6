"""The wheel works without the checkout: command, presets, page templates and tested versions are in the package."""

import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]


def test_the_smoke_study_runs_from_an_installed_wheel_in_an_empty_folder(tmp_path):
    """The environment holds the wheel, and sees the packages that this one has; the checkout is nowhere on its path."""
    source, python = tmp_path / "source", tmp_path / "venv" / "bin" / "python"
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(source)], check=True)
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "."]
    subprocess.run([*build, "--wheel-dir", str(tmp_path)], cwd=source, check=True)
    (wheel,) = tmp_path.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    needed = [f"pipeline/presets/{path.name}" for path in (ROOT / "configs").glob("*.yaml")]
    needed += [
        str(path.relative_to(ROOT)) for kind in ("html", "css", "js") for path in ROOT.glob(f"pipeline/**/*.{kind}")
    ]
    needed += [f"pipeline/bench/fabrication/guides/{name}" for name in ("assembly.md", "servo.md", "servo-wiring.svg")]
    assert {"pipeline/constraints.txt", "pipeline/py.typed", "puddle/py.typed", "tasks/py.typed", *needed} <= names
    assert {name.split("/")[0] for name in names if ".dist-info" not in name} == {"pipeline", "puddle", "tasks"}

    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(tmp_path / "venv")], check=True)
    (site,) = (tmp_path / "venv").glob("lib/python*/site-packages")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment["MLFLOW_TRACKING_URI"] = "http://127.0.0.1:1"  # no server: it takes four core-seconds less
    install = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--no-deps", str(wheel)]
    subprocess.run(install, env=environment, check=True)
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    empty = tmp_path / "empty"
    empty.mkdir()

    def ran(*command: str) -> str:
        words = [str(python.with_name(command[0])), *command[1:]]
        done = subprocess.run(words, cwd=empty, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    where = "import puddle, pipeline, tasks; print(puddle.__file__, pipeline.__file__, tasks.__file__)"
    assert ran("python", "-c", where).count(str(site)) == 3
    shorter = ("grid.depths=[9]", "grid.n_trials=1", "rollout.n_measure=60", "throws.n_throws=10")
    shorter += ("grid.environments=[dry_land]", "grid.single_member_depths=[]")
    ran("puddle", "study", "--preset", "smoke", "--workers", "0", *(word for one in shorter for word in ("--set", one)))
    assert (empty / "store" / "studies" / "smoke" / "report" / "index.html").stat().st_size > 50_000
