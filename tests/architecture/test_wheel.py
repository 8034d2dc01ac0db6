"""The wheel works without the checkout: command, presets, page templates and tested versions are in the package."""

import email
import os
import re
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """The wheel, built from the tracked files alone."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(source)], check=True)
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "."]
    subprocess.run([*build, "--wheel-dir", str(folder)], cwd=source, check=True)
    (built,) = folder.glob("*.whl")
    return built


def test_the_wheel_holds_the_files_that_the_command_reads(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    presets = {f"pipeline/presets/{path.name}" for path in (ROOT / "configs").glob("*.yaml")}
    templates = {
        str(path.relative_to(ROOT)) for kind in ("html", "css", "js") for path in ROOT.glob(f"pipeline/*/*.{kind}")
    }
    assert presets and templates
    assert {
        "pipeline/constraints.txt",
        "pipeline/py.typed",
        "puddle/py.typed",
        "tasks/py.typed",
        *presets,
        *templates,
        *(f"pipeline/fabrication/guides/{name}" for name in ("assembly.md", "servo.md", "servo-wiring.svg")),
    } <= names
    assert {name.split("/")[0] for name in names if ".dist-info" not in name} == {"pipeline", "puddle", "tasks"}


def test_the_wheel_describes_itself(wheel):
    archive = zipfile.ZipFile(wheel)
    (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
    metadata = email.message_from_bytes(archive.read(name))
    assert metadata["Name"] == "puddle" and metadata["Requires-Python"] == "<3.14,>=3.11"
    assert "Typing :: Typed" in metadata.get_all("Classifier")
    capped = {re.split(r"[\s<>=!;\[]", line)[0]: line for line in metadata.get_all("Requires-Dist")}
    assert "<2.61" in capped["ray"] and "<3.18" in capped["mlflow"] and capped["torch"].startswith("torch==")


def test_the_smoke_study_runs_from_an_installed_wheel_in_an_empty_folder(wheel, tmp_path):
    """The environment holds the wheel, and sees the packages that this one has; the checkout is nowhere on its path."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(tmp_path / "venv")], check=True)
    python = tmp_path / "venv" / "bin" / "python"
    (site,) = (tmp_path / "venv").glob("lib/python*/site-packages")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment["MLFLOW_TRACKING_URI"] = "http://127.0.0.1:1"  # no server: it takes four core-seconds less
    install = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--no-deps", str(wheel)]
    subprocess.run(install, env=environment, check=True)
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    empty = tmp_path / "empty"
    empty.mkdir()

    def puddle(*arguments: str) -> str:
        command = [str(tmp_path / "venv" / "bin" / "puddle"), *arguments]
        ran = subprocess.run(command, cwd=empty, env=environment, capture_output=True, text=True, check=False)
        assert ran.returncode == 0, ran.stderr
        return ran.stdout

    where = "import puddle, pipeline, tasks; print(puddle.__file__, pipeline.__file__, tasks.__file__)"
    shown = subprocess.run(
        [str(python), "-c", where], cwd=empty, env=environment, capture_output=True, text=True, check=True
    )
    assert shown.stdout.count(str(site)) == 3
    shorter = ("grid.depths=[9]", "grid.n_trials=1", "rollout.n_measure=60", "throws.n_throws=10")
    shorter += ("grid.environments=[residual_slush]", "grid.single_member_depths=[]")
    puddle("study", "--preset", "smoke", "--workers", "0", *(word for one in shorter for word in ("--set", one)))
    assert (empty / "store" / "studies" / "smoke" / "report" / "index.html").stat().st_size > 100_000
    assert "report    done" in puddle("status", "--study", "smoke")
