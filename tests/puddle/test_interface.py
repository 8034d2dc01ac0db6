"""`import puddle`: the names that users rely on."""

import importlib.metadata
import subprocess
import sys

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
