"""The recipes of docs/extending.md for a medium, an objective, a search, an analysis and genes, performed and run, and
undone: what studies have recorded stays readable.
"""

import contextlib
import json
import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import polars
import pytest

import puddle
from tasks.simulation.mjcf import mjcf

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]

STUDY = """
name: changed
target: honey
throws: {n_throws: 6, n_steps: 20}
network: {hidden_layers: 1, width: 4}
training: {n_iterations: 20, batch_size: 64}
ensemble: {n_members: 2}
grid: {depths: [1.0], single_member_depths: [], n_trials: 1}
rollout: {n_settle: 20, n_measure: 20}
evolution: {n_generations: 4, objective: com_displacement, morphology: {n_actuated: 2}, afpo: {population_size: 4}}
transfer: {n_generations: 3}
assess: {n_designs: 5}
work: {engine: reference}
"""

RUN = """
import json, sys
from pathlib import Path
import puddle
from small_study import run
from pipeline.cluster import serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.report import page
from pipeline.stages import STAGES
from pipeline.store.store import Store
from pipeline.workflow.record import DrivenStudy

page.FIGURES = {"transfer_at_depth": page.FIGURES["transfer_at_depth"]}  # all of them take seconds
given = sys.stdin.read()
settings = parse(Settings, given, name="changed")
changes = ["name=searched", "grid.environments=[honey]", "evolution.search=random_search"]
changes.append("evolution.random_search={population_size: 8}")
searched = parse(Settings, given, name="searched", overrides=changes)
store = Store.open(Path("store"), create=True)
with serial_cluster() as cluster:
    upstream = run(settings, store, cluster)
    DrivenStudy(searched, store, print).update(run(searched, store, cluster, STAGES[:5]))  # to the transfer
DrivenStudy(settings, store, print).update(upstream)
for stage, results in upstream.items():
    for chain, manifests in results.done.items():
        folder = Path("out", stage, chain.label)
        folder.mkdir(parents=True)
        for manifest in manifests:
            for name in manifest.files:
                (folder / name).write_bytes(store.read(manifest, name))
failed = [f"{stage} {of.label}: {why}" for stage in upstream for of, why in upstream[stage].failed.items()]
reach = puddle.open_study("changed", "store").table("reach")
found = puddle.open_study("searched", "store")
history, champions = found.table("histories"), found.champions()
best = [max(history["fitness"].to_pylist()), *history["operator"].unique().to_pylist(), history.num_rows]
print(json.dumps([failed, reach.num_rows, reach.column_names, [*best, champions["fitness"].to_pylist()]]))
"""

SHOW = """
import json, warnings
from pathlib import Path
import puddle
from pipeline.results.export_folder import export_study

shown = []
for name in ("changed", "searched"):
    with warnings.catch_warnings(record=True) as said:
        study = puddle.open_study(name, "store")
    champions = [(row["environment"], row["fitness"]) for row in study.champions().to_pylist()]
    shown.append([*(str(one.message) for one in said), champions, study.settings.model_dump()["honey"]])
export_study(puddle.open_study("changed", "store"), Path("exported"))
for ask in (lambda: study.simulate(study.champion("honey", depth=1.0, trial=0)), lambda: study.table("reach")):
    try:
        ask()
    except puddle.PuddleError as refused:
        shown.append(str(refused))
print(json.dumps([shown, study.settings.evolution.optimiser]))
"""

HONEY, _, _, _, OBJECTIVE, SEARCH, CMA_ES, ANALYSIS, MUJOCO = re.findall(
    r"^```python\n(.*?)^```$", (ROOT / "docs" / "extending.md").read_text(), flags=re.M | re.S
)
ADDED = {
    "tasks/world/honey.py": HONEY,
    "tasks/evolution/objectives/com_displacement.py": OBJECTIVE,
    "tasks/evolution/random_search.py": SEARCH,
    "tasks/analysis/tables/reach.py": ANALYSIS,
}
LOST = -math.expm1(-5.0 / 60)  # share of a velocity that a step in honey takes

CHANGED = {
    "tasks/design/gene.py": [
        (
            '    Gene("frequency", ',
            '    Gene("bend", "control", "interval", -1.0, 1.0, "rad", False),\n'
            '    Gene("hollow", "body", "flag", 0.0, 1.0, "", True),\n'
            '    Gene("girth", "body", "interval", 0.5, 2.0, "m", True, per_link=False),\n'
            '    Gene("frequency", ',
        )
    ],
    "tasks/design/genes.py": [
        (
            "    frequency: Float64  #",
            "    bend: Float64\n    hollow: Bools\n    girth: Float64\n    frequency: Float64  #",
        )
    ],
    "pipeline/stages/evolve.py": [("    version=3,\n", "    version=4,\n")],
}


def test_cma_es_outside_a_study():
    """Fewer generations than on the page already find a better gait than the best of its random designs."""
    assert CMA_ES.count("range(60)") == 1
    found = {}
    exec(CMA_ES.replace("range(60)", "range(5)"), found)
    best = puddle.simulate(found["best"], found["here"]).displacement
    assert found["score"].max() > best


def test_an_exported_model_plays_in_mujoco(tmp_path, monkeypatch):
    """The viewer, which needs a screen, is closed after ten seconds of simulation; the robot has moved by then."""
    viewer = pytest.importorskip("mujoco.viewer", reason="mujoco is not installed")

    @contextlib.contextmanager
    def launched(model, data):
        yield SimpleNamespace(is_running=lambda: data.time < 10, sync=lambda: None)

    monkeypatch.setattr(viewer, "launch_passive", launched)
    design = puddle.random_designs(12, np.random.default_rng(1))[11]
    (tmp_path / "robot.xml").write_text(mjcf(design, 0.0))
    assert MUJOCO.count('"results/champions/dry_land-9m-trial-0.xml"') == 1
    played = {}
    exec(MUJOCO.replace("results/champions/dry_land-9m-trial-0.xml", str(tmp_path / "robot.xml")), played)
    assert abs(played["data"].qpos[0]) > 0.1


@pytest.mark.timeout(600)
def test_a_target_an_objective_an_analysis_and_genes(tmp_path):
    """Four recipes in one study, none of which touches what the others do. Kernels are not compiled."""
    for package in ("tasks", "pipeline", "puddle"):
        shutil.copytree(ROOT / package, tmp_path / package)
    for name, text in ADDED.items():
        (tmp_path / name).write_text(text)
    for name, replacements in CHANGED.items():
        text = (tmp_path / name).read_text()
        for old, new in replacements:
            assert text.count(old) == 1, f"{name} has {text.count(old)} times {old!r}, expected once"
            text = text.replace(old, new)
        (tmp_path / name).write_text(text)
    failed, n_rows, columns, (best, operator, n_designs, champions) = _run(RUN, tmp_path)
    assert failed == [] and (n_rows, columns) == (3, ["environment", "depth", "trial", "longest"])
    assert (operator, n_designs, champions) == ("random", 4 * 8, [best])
    out = tmp_path / "out"
    (throws,) = (out / "collect").glob("*/*/transitions.parquet")
    table = polars.read_parquet(throws)
    velocity, change = (np.stack(table[name].to_numpy())[:, 3:] for name in ("state", "residual"))
    wet = change.any(axis=1)
    assert wet.any() and not wet.all()
    np.testing.assert_allclose(change[wet], -LOST * velocity[wet], rtol=1e-3, atol=1e-5)
    for stage in ("evolve", "adapt"):
        (history,) = (out / stage / "honey").glob("**/history.parquet")
        table = polars.read_parquet(history)
        com, root = (np.stack(table[name].to_numpy())[:, 0] for name in ("com_displacement", "displacement"))
        np.testing.assert_array_equal(table["fitness"].to_numpy(), com)
        assert (com != root).any()
    (history,) = (out / "evolve" / "honey").glob("**/history.parquet")
    designs = polars.read_parquet(history)
    bend, hollow, motors = (np.stack(designs[name].to_numpy()) for name in ("bend", "hollow", "motor_on"))
    assert (abs(bend) <= 1).all() and not bend[:, 0].any() and bend[:, 1:].all()
    assert len(set(hollow.sum(axis=1))) > 1
    assert (motors.sum(axis=1) == 2).all()  # a flag that is not a motor does not count as one
    assert designs["girth"].is_between(0.5, 2.0).all() and designs["girth"].n_unique() > 1
    scored = out / "transfer/honey/1m/trial-0"
    before, after = (json.loads((scored / name).read_text()) for name in ("champion.json", "adapted.json"))
    assert (before["hollow"], before["girth"]) == (after["hollow"], after["girth"]) and before["bend"] != after["bend"]
    score = json.loads((scored / "score.json").read_text())
    assert score["zero_shot"] == score["predicted"]  # the target is the honey that it evolved in
    assert score["zero_shot_score"] == score["fitness"] != score["zero_shot"]
    page = (out / "report/index.html/index.html").read_text()
    assert "displacement of the centre of mass [m]" in page and "longest link [m]" in page
    assert "m of Honey, the displacement of the centre of mass of zero-shot champions was" in page
    assert "Transfer to Honey" in page
    assert not any(word in page for word in ("True Slush", "paper</", "paper’s"))
    for name in ADDED:
        (tmp_path / name).unlink()
    ((*notes, of_changed, honey), (*more, of_searched, _), *refused), optimiser = _run(SHOW, tmp_path)
    assert [note.split(". ")[1] for note in (*notes, *more)] == [
        "The code of com_displacement, honey, reach is not here.",
        "The code of com_displacement, honey, random_search is not here.",
    ]
    assert [name for name, _ in of_changed] == ["honey", "dry_land", "residual_slush"]
    assert of_searched == [["honey", best]] and optimiser == {"population_size": 8} and honey == {"decay": 5.0}
    assert "expected one of true_slush" in refused[0] and "got 'honey'" in refused[0] and "table, one of" in refused[1]
    rows = polars.read_parquet(tmp_path / "exported/tables/reach.parquet")
    assert rows.columns == columns and len(rows) == n_rows


def _run(script: str, folder: Path):
    """Run a script with the copy's sources, and return the JSON of the last line that it prints."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "tests" / "shared"), "NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, cwd=folder, env=environment, input=STUDY, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])
