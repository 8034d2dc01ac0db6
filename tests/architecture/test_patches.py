"""The patches of docs/sensitivity.md apply to this code, and each changes the course of evolution."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PATCHES = sorted((ROOT / "docs" / "patches").glob("*.patch"))

RUN = """
import json
from functools import partial
from tasks.evolution import Afpo, Trial, evaluate, evolve
from tasks.seeding import generator
from tasks.simulation import simulate
from tasks.world import TrueSlush

def score(designs):
    return evaluate(simulate(designs, TrueSlush(1.0), n_settle=6, n_measure=4), disagreement_penalty=0.0)

afpo = Afpo(population_size=6)
afpo = afpo.model_copy(update={"mutation": afpo.mutation.model_copy(update={"step": 1.0})})  # as patch 1 asks for
((_, history),) = evolve([Trial(partial(generator, 1))], score, first_generation=0, n_generations=3, afpo=afpo)
print(json.dumps(history["fitness"].tolist()))
"""


def fitness(folder: Path) -> list[float]:
    """Evolve a few designs with the sources in a folder, in plain Python: their kernels would be compiled anew."""
    environment = {**os.environ, "PYTHONPATH": str(folder), "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, "-c", RUN], cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def as_decided() -> list[float]:
    return fitness(ROOT)


def test_the_page_names_every_patch_and_no_other():
    named = set(re.findall(r"patch (\d+) \|", (ROOT / "docs" / "sensitivity.md").read_text()))
    assert {path.stem for path in PATCHES} == named and named


@pytest.mark.parametrize("patch", PATCHES, ids=lambda path: path.name)
def test_a_patch_applies_and_changes_the_course_of_evolution(patch: Path, tmp_path: Path, as_decided: list[float]):
    shutil.copytree(ROOT / "tasks", tmp_path / "tasks", ignore=shutil.ignore_patterns("__pycache__"))
    outside = {**os.environ, "GIT_CEILING_DIRECTORIES": str(tmp_path.parent)}  # git must ignore a repository around it
    done = subprocess.run(["git", "apply", str(patch)], cwd=tmp_path, env=outside, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    changed = fitness(tmp_path)
    assert len(changed) == len(as_decided) and changed != as_decided
