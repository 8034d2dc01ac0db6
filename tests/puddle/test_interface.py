"""`import puddle`: the names that users rely on."""

import importlib.metadata
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pyarrow.parquet as pq
import pytest

import puddle
import tasks.design
import tasks.simulation
import tasks.world
from tasks.world.flowing_slush import FlowingSlush


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


def test_dir_lists_the_names_alone():
    assert set(dir(puddle)) == {*puddle.__all__, "__doc__", "__version__"}


def test_importing_it_loads_no_cluster_no_tracking_and_no_torch():
    slow = ("ray", "mlflow", "torch", "matplotlib", "scipy.optimize", "scipy.spatial")
    script = f"import puddle, sys; print([name for name in {slow} if name in sys.modules])"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert loaded.stdout.strip() == "[]"


def test_puddle_is_imported_beside_a_user_s_own_modules(tmp_path):
    for shadow in ("tasks.py", "pipeline/__init__.py", "puddle/README.md"):
        (tmp_path / shadow).parent.mkdir(exist_ok=True)
        (tmp_path / shadow).write_text("MINE = 1\n")
    root = Path(puddle.__file__).parents[1]
    program = f"import sys; sys.path.append({str(root)!r}); import puddle, tasks; print(tasks.__file__)"
    ran = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert Path(ran.stdout.strip()) == root / "tasks" / "__init__.py"


def test_a_design_is_saved_and_loaded(tmp_path):
    design = puddle.random_designs(1, np.random.default_rng(0))
    puddle.save_design(design, tmp_path / "design.json")
    assert puddle.load_design(tmp_path / "design.json") == design
    with pytest.raises(puddle.PuddleError, match="expected one design, got 2"):
        puddle.save_design(puddle.random_designs(2, np.random.default_rng(0)), tmp_path / "two.json")
    with pytest.raises(puddle.PuddleError, match=r"frequency is 3.0, expected 0 to 0.3 Hz"):
        puddle.save_design(replace(design, frequency=np.array([3.0])), tmp_path / "fast.json")


def test_published_champions_travel_as_their_table_says():
    path = Path(puddle.__file__).parents[1] / "docs" / "champions.parquet"
    table, designs = pq.read_table(path), puddle.open_designs(path)
    assert len(table) == len(designs) > 0
    for depth in np.unique(table["depth"]):
        there = np.flatnonzero(table["depth"].to_numpy() == depth)
        travelled = puddle.simulate(designs[there], puddle.TrueSlush(float(depth))).displacement
        assert (travelled == table["zero_shot"].to_numpy()[there]).all()


class Honey:
    """A medium of a notebook: everything in it stands still."""

    def velocity_change(self, links, physics):
        held = links.y < 0
        return puddle.VelocityChange(*(np.where(held, -v, 0 * v) for v in (links.vx, links.vy, links.omega)))


def test_a_design_is_filmed_in_a_medium_of_ones_own(tmp_path):
    design, at = puddle.random_designs(1, np.random.default_rng(0)), puddle.Pool(9.0, Honey())
    puddle.film(design, at, tmp_path / "honey.mp4", n_settle=20, n_measure=60)
    with av.open(tmp_path / "honey.mp4") as shown:
        assert shown.streams.video[0].frames == 31
    in_air = puddle.simulate(design, puddle.DryLand(9.0), n_settle=0, n_measure=60, trace=True).trace
    assert (puddle.simulate(design, at, n_settle=0, n_measure=60, trace=True).trace != in_air).any()
    with pytest.raises(puddle.PuddleError, match=r"ends in .gif or .mp4, got honey.avi"):
        puddle.film(design, at, tmp_path / "honey.avi")


def test_an_environment_is_also_a_name_or_a_medium():
    designs, steps = puddle.random_designs(3, np.random.default_rng(0)), {"n_settle": 20, "n_measure": 60}
    for short, depth, whole in (
        ("true_slush", None, puddle.TrueSlush(9.0)),
        ("flowing_slush", 2.0, puddle.Pool(2.0, FlowingSlush())),
        ("randomised_slush", None, puddle.RandomisedSlush(9.0)),
        (Honey(), 2.0, puddle.Pool(2.0, Honey())),
    ):
        found = puddle.simulate(designs, short, depth=depth, **steps).displacement
        np.testing.assert_array_equal(found, puddle.simulate(designs, whole, **steps).displacement)


@pytest.mark.parametrize(
    ("arguments", "error", "said"),
    [
        ({"environment": "mud"}, ValueError, r"environment: expected one of true_slush, dry_land, .*, got 'mud'"),
        ({"environment": "residual_slush"}, ValueError, r"or ResidualSlush\(depth, ensemble\) for networks, got"),
        ({"environment": puddle.TrueSlush}, TypeError, "environment: expected one, such as TrueSlush"),
        ({"environment": Honey}, TypeError, "environment: expected one, such as TrueSlush"),
        ({"environment": None}, TypeError, "environment: expected one, such as TrueSlush"),
        ({"environment": puddle.DryLand(1.0), "depth": 2.0}, ValueError, "depth is 2.0, but the environment has"),
        ({"designs": {"frequency": [0.1]}}, TypeError, "designs: expected Designs, got dict"),
        ({"physics": 3}, TypeError, "physics: expected Physics, got int"),
        ({"n_measure": 0}, ValueError, "n_measure is 0, expected at least 1"),
        ({"n_settle": 1.5}, ValueError, "n_settle is 1.5, expected at least 0, a whole number"),
        ({"engine": "fast"}, ValueError, "engine is 'fast', expected any of batch, reference, mujoco"),
    ],
)
def test_a_wrong_argument_of_simulate_is_named(arguments, error, said):
    usual = {"designs": puddle.random_designs(1, np.random.default_rng(0)), "environment": "true_slush"}
    with pytest.raises(error, match=said):
        puddle.simulate(**usual | arguments)
