"""Files of a user's own, given by --with: imported wherever a study is computed, and refused in one line."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import WITHOUT_MLFLOW

import puddle
from pipeline.extensions import VARIABLE
from pipeline.results.recorded_study import Study

ROOT = Path(__file__).parents[2]
HONEY, SPRINGS, FORM, CONTROLLER, *_ = re.findall(
    r"```python\n(.*?)```", (ROOT / "docs" / "extending.md").read_text(), flags=re.DOTALL
)
OBJECTIVE = """
from tasks.evolution.objectives.evaluation import Objective, register_objective

register_objective(Objective("backwards", "Backwards", "m", lambda rollouts: -rollouts.displacement))
"""


@pytest.fixture
def run(tmp_path):
    """Run Python in a folder with a medium and an objective outside the sources."""
    (tmp_path / "molasses.py").write_text(HONEY.replace('"honey"', '"molasses"'))
    (tmp_path / "aims.py").write_text(OBJECTIVE)
    (tmp_path / "springs.py").write_text(SPRINGS)

    def python(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-P", *arguments]
        variables = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
        return subprocess.run(command, cwd=tmp_path, env=variables, capture_output=True, text=True)

    return python


def opened(name: str, store: Path, *files: str) -> Study:
    """Open a study in this process, which has not imported its files."""
    with pytest.warns(UserWarning, match=f"The code of {', '.join(files)} is not here"):
        return puddle.open_study(name, store)


def changes(*overrides: str) -> list[str]:
    return [word for override in overrides for word in ("--set", override)]


@pytest.fixture
def studied(run, tmp_path):
    """Run the smoke study with a file and overrides; return its record, as read without the file."""

    def study(name: str, text: str, *overrides: str) -> Study:
        (tmp_path / f"{name}.py").write_text(text)
        options = ("--preset", "smoke", "--with", f"{name}.py", "--workers", "0", "--store", "store")
        done = run("-m", "pipeline", "study", *options, *changes(*overrides), *WITHOUT_MLFLOW)
        assert done.returncode == 0, done.stderr
        return opened("smoke", tmp_path / "store", name)

    return study


def test_results_in_a_medium_with_memory_do_not_depend_on_the_number_of_workers(run, tmp_path):
    """Its settings have a place, an objective of another file is known, and the record has the digest of both."""
    small = ("evolution.n_generations=2", "rollout.n_measure=100", "grid.depths=[1]", "evolution.objective=backwards")
    small += ("target=springs", "grid.environments=[springs]", "springs.stiffness=30")
    files, found = ("--with", "springs.py", "--with", "aims.py"), []
    for workers in ("0", "2"):
        options = ("--preset", "smoke", *files, "--workers", workers, "--store", workers)
        done = run("-m", "pipeline", "evolve", *options, *changes(*small), *WITHOUT_MLFLOW)
        assert done.returncode == 0, done.stderr
        study = opened("smoke", tmp_path / workers, "backwards", "springs")
        assert study.settings.model_dump()["springs"]["stiffness"] == 30
        found.append(study.table("histories"))
    assert found[0].equals(found[1]) and set(found[0]["environment"].to_pylist()) == {"springs"}
    assert found[0]["fitness"].to_pylist() == [-moved for (moved,) in found[0]["displacement"].to_pylist()]
    (tmp_path / "aims.py").write_text(OBJECTIVE + "\nlimit = 1\n")
    again = run("-m", "pipeline", "status", "smoke", *files, "--store", "0")
    assert "A different version of the code made items of evolve" in again.stderr + again.stdout


def test_a_medium_that_is_infinite_under_water_is_refused_before_anything_is_computed(run, tmp_path):
    """The robot that media are tried with begins above the water."""
    lift = "lift = wet * physics.gravity * links.mass"
    assert lift in SPRINGS
    (tmp_path / "springs.py").write_text(SPRINGS.replace(lift, "lift = np.where(wet, np.inf, 0.0)"))
    options = ("--preset", "smoke", "--with", "springs.py", "--set", "target=springs", "--workers", "0", "--store", "s")
    done = run("-m", "pipeline", "study", *options)
    assert done.returncode == 2 and "vy: expected finite numbers in the first step" in done.stderr
    assert done.stderr.count("\n") == 1 and "springs.py:" in done.stderr


def test_designs_evolve_in_networks_of_a_form_of_a_file(studied):
    """They are trained and compiled as any; the study is readable without the file, which it names."""
    small = ("training.n_iterations=50", "evolution.n_generations=2", "transfer.n_generations=1")
    grid = "grid={depths: [9], environments: [residual_slush], single_member_depths: [], n_trials: 1}"
    assert studied("link_axes", FORM, "network.form=link_axes", *small, grid).champions().num_rows


def test_designs_evolve_with_a_controller_of_a_file(studied, run, tmp_path):
    """Its genes are in tables and design files; the study is readable without the file, which it names."""
    small = ("evolution.n_generations=2", "transfer.n_generations=2")
    grid = "grid={depths: [1], environments: [true_slush], single_member_depths: [], n_trials: 1}"
    study = studied("wet_swing", CONTROLLER, "evolution.controller=wet_swing", *small, grid)
    gains = json.loads(study.champions()["design_json"][0].as_py())["wet_swing.wet"]
    assert gains[0] == 0 and max(map(abs, gains)) <= 1
    page = (tmp_path / "store/studies/smoke/report/index.html").read_text()
    assert "Robots of 6 rigid links evolve, body and controller (wet_swing) together" in page
    words = ("export", "smoke", "--with", "wet_swing.py", "--store", "store", "--mjcf", "--out", "out")
    assert run("-m", "pipeline", *words).returncode == 0
    assert 'data="wet_swing"' in (tmp_path / "out/champions/true_slush-1m-trial-0.xml").read_text()


def test_a_process_without_the_file_imports_its_text(run, tmp_path):
    text = (tmp_path / "molasses.py").read_text()
    elsewhere = json.dumps({"molasses": ["/elsewhere/molasses.py", text]})
    program = """
import pipeline.kernels, tasks.world
medium = tasks.world.ENVIRONMENTS["molasses"].settings
print(pipeline.kernels.kernel_sources(medium.law)["molasses"] == {text!r}, medium.model_fields["decay"].description)
"""
    done = run("-c", program.replace("{text!r}", repr(text.encode())), **{VARIABLE: elsewhere})
    assert done.stdout == "True Rate at which velocities decay [1/s].\n", done.stderr


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("json.py", "", "--with json.py: expected a file NAME.py whose name no other module has"),
        ("a-b.py", "", "--with a-b.py: expected a file NAME.py whose name no other module has"),
        ("broken.py", "x = 1\ny = (", r"--with .*/broken.py:2: SyntaxError: '\(' was never closed"),
        ("missing.py", None, "missing.py: No such file or directory"),
    ],
)
def test_a_file_that_is_no_extension_is_refused_in_one_line(run, tmp_path, name, text, message):
    if text is not None:
        (tmp_path / name).write_text(text)
    done = run("-m", "pipeline", "settings", "--preset", "smoke", "--with", name)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert re.search(message, done.stderr), done.stderr
