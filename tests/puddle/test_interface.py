"""`import puddle`: the names that users rely on."""

import importlib.metadata
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import puddle
import tasks.design
import tasks.simulation
import tasks.world


def test_names_are_those_of_the_packages():
    for package, names in (
        (tasks.design, ("Designs", "crossover", "mutate", "random_designs")),
        (tasks.world, ("DryLand", "RandomisedSlush", "ResidualSlush", "TrueSlush")),
        (tasks.simulation, ("simulate",)),
    ):
        for name in names:
            assert getattr(puddle, name) is getattr(package, name)
    assert all(getattr(puddle, name).__doc__ for name in puddle.__all__)
    assert puddle.__version__ == importlib.metadata.version("puddle")


def test_importing_it_loads_no_cluster_no_tracking_and_no_torch():
    slow = ("ray", "mlflow", "torch", "matplotlib", "scipy.optimize", "scipy.spatial")
    script = f"import puddle, sys; print([name for name in {slow} if name in sys.modules])"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert loaded.stdout.strip() == "[]"


@pytest.mark.parametrize("shadow", ["tasks.py", "tasks/__init__.py", "pipeline/__init__.py", "puddle/README.md"])
def test_puddle_is_imported_beside_a_user_s_own_modules(shadow, tmp_path):
    (tmp_path / shadow).parent.mkdir(exist_ok=True)
    (tmp_path / shadow).write_text("MINE = 1\n")
    root = Path(puddle.__file__).parents[1]
    program = f"import sys; sys.path.append({str(root)!r}); import puddle, tasks; print(tasks.__file__)"
    ran = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert Path(ran.stdout.strip()) == root / "tasks" / "__init__.py"


def test_a_name_is_no_environment():
    designs = puddle.random_designs(1, np.random.default_rng(0))
    with pytest.raises(TypeError, match=r"environment: expected one, such as TrueSlush\(depth=9.0\), got 'true_slush'"):
        puddle.simulate(designs, "true_slush")
