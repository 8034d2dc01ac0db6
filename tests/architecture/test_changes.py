"""The recipes of docs/extending.md for media, an objective, an analysis and genes, performed in a copy and run."""

import base64
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import polars
import pytest

from pipeline.report.replay import MOST_ACCELERATION

ROOT = Path(__file__).parents[2]

STUDY = """
name: changed
throws: {n_throws: 6, n_steps: 20}
network: {hidden_layers: 1, width: 4}
training: {n_iterations: 20, batch_size: 64}
ensemble: {n_members: 2}
grid: {depths: [1.0], single_member_depths: [], n_trials: 1}
rollout: {n_settle: 60, n_measure: 60}
evolution: {n_generations: 4, afpo: {population_size: 4}}
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
from pipeline.stages.analyse import ANALYSE
from pipeline.store.store import Store
from pipeline.workflow.record import DrivenStudy

settings = parse(Settings, sys.stdin.read(), name="changed")
store = Store.open(Path("store"), create=True)
with serial_cluster() as cluster:
    upstream = run(settings, store, cluster)
DrivenStudy(settings, store, print).update(upstream, finished=True)
of_analyses = ANALYSE.summarise(settings, upstream["analyse"], store).artifacts
tables = {name: puddle.open_study("changed", "store").table(name.removesuffix(".csv")) for name in of_analyses}
Path("tables.json").write_text(json.dumps({name: [len(table), table.column_names] for name, table in tables.items()}))
for stage, results in upstream.items():
    for chain, manifests in results.done.items():
        folder = Path("out", stage, chain.label)
        folder.mkdir(parents=True)
        for manifest in manifests:
            for name in manifest.files:
                (folder / name).write_bytes(store.read(manifest, name))
print(json.dumps([f"{stage} {of.label}: {why}" for stage in upstream for of, why in upstream[stage].failed.items()]))
"""

EXTENDING = (ROOT / "docs" / "extending.md").read_text()
TAR, OBJECTIVE, ANALYSIS = re.findall(r"^```python\n(.*?)^```$", EXTENDING, flags=re.M | re.S)
PULL, TIME_STEP = 3.0, 1 / 60

LEARN_TAR = {
    "tasks/world/slush.py": [
        (
            "from tasks.world.registry import",
            "from tasks.world.tar import Tar, TarPit\nfrom tasks.world.registry import",
        ),
        (
            '        build=TrueSlush,\n        settings_group="slush",\n        settings=Slush,\n',
            '        build=TarPit,\n        settings_group="tar",\n        settings=Tar,\n',
        ),
    ]
}

GENE = {
    "tasks/design/genes.py": [
        (
            '    Gene("frequency", ',
            '    Gene("bend", "control", "interval", -1.0, 1.0, "rad", False),\n'
            '    Gene("hollow", "body", "flag", 0.0, 1.0, "", True),\n'
            '    Gene("girth", "body", "interval", 0.5, 2.0, "m", True, per_link=False),\n'
            '    Gene("frequency", ',
        ),
        (
            "    frequency: Float64  #",
            "    bend: Float64\n    hollow: Bools\n    girth: Float64\n    frequency: Float64  #",
        ),
    ],
    "pipeline/stages/evolve.py": [("    version=2,\n", "    version=3,\n")],
}


def change(copy: Path, edits: dict[str, list[tuple[str, str]]]) -> None:
    for name, replacements in edits.items():
        text = (copy / name).read_text()
        for old, new in replacements:
            assert text.count(old) == 1, f"{name} has {text.count(old)} times {old!r}, expected once"
            text = text.replace(old, new)
        (copy / name).write_text(text)


def run(copy: Path, settings: str) -> list[str]:
    """Run a study in a copy, which puts its files into out/; return the chains that failed.

    Kernels are not compiled: all of them would be compiled anew, for a few steps of a few designs.

    Args:
        copy: the copy.
        settings: settings of the study, as YAML.
    """
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "tests" / "shared"), "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(
        [sys.executable, "-c", RUN], cwd=copy, env=environment, input=settings, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of the sources, and of what Python has compiled them to."""
    for package in ("tasks", "pipeline", "puddle"):
        shutil.copytree(ROOT / package, tmp_path / package)
    return tmp_path


def pushes(copy: Path) -> dict[tuple[str, str], np.ndarray]:
    """Read the accelerations of links by the medium from the page [m/s²], by environment of evolution and of replay."""
    page = (copy / "out" / "report" / "index.html" / "index.html").read_text()
    replays = json.loads(re.search(r'id="replays">(.*?)</script>', page).group(1))
    assert all(replay["pushQuantum"] == MOST_ACCELERATION / 127 for replay in replays)
    where = [(replay["environment"], replay["seenIn"]) for replay in replays]
    push = [np.frombuffer(base64.b64decode(replay["push"]), np.int8).reshape(-1, 2) for replay in replays]
    return dict(zip(where, push, strict=True))


@pytest.mark.timeout(600)
def test_a_medium_to_learn_and_to_transfer_to(copy):
    (copy / "tasks/world/tar.py").write_text(TAR)
    change(copy, LEARN_TAR)
    settings = STUDY.replace("depths: [1.0],", "depths: [1.0], environments: [true_slush, residual_slush],", 1)
    assert run(copy, settings) == []
    (throws,) = (copy / "out" / "collect").glob("*/transitions.parquet")
    residual = np.stack(polars.read_parquet(throws)["residual"].to_numpy())
    pulled = np.isclose(residual[:, 3], PULL * TIME_STEP, rtol=1e-4)
    assert pulled.any() and not residual[~pulled, 3].any() and not residual[:, 4:].any()
    scores = json.loads((copy / "out/transfer/true_slush/1m/trial-0/score.json").read_text())
    assert scores["zero_shot"] == scores["predicted"]
    assert not any(push[:, 1].any() for (_, seen_in), push in pushes(copy).items() if seen_in == "True Slush")
    errors = polars.read_parquet(copy / "out/analyse/member_errors/residual_slush/1m/member_errors.parquet")
    assert errors.filter(component="vy")["rms_true"].max() == 0


@pytest.mark.timeout(600)
def test_a_medium_to_evolve_in_an_objective_an_analysis_and_genes(copy):
    """Four recipes in one study, none of which touches what the others do."""
    (copy / "tasks/world/tar.py").write_text(TAR)
    (copy / "tasks/evolution/objectives/com_displacement.py").write_text(OBJECTIVE)
    (copy / "tasks/analysis/tables/reach.py").write_text(ANALYSIS)
    change(copy, GENE)
    settings = STUDY.replace("depths: [1.0],", "depths: [1.0], environments: [true_slush, tar_pit],", 1)
    settings = settings.replace("afpo:", "objective: com_displacement, morphology: {n_actuated: 2}, afpo:")
    assert run(copy, settings) == []
    tables = {}
    for stage in ("evolve", "transfer"):
        (history,) = (copy / "out" / stage / "true_slush").glob("**/history.parquet")
        tables[stage] = table = polars.read_parquet(history)
        com, root = (np.stack(table[name].to_numpy())[:, 0] for name in ("com_displacement", "displacement"))
        np.testing.assert_array_equal(table["fitness"].to_numpy(), com)
        assert (com != root).any()
    page = (copy / "out" / "report" / "index.html" / "index.html").read_text()
    assert "displacement of the centre of mass [m]" in page and "Tar Pit" in page
    n_rows, columns = json.loads((copy / "tables.json").read_text())["reach.csv"]  # read by its name
    assert (n_rows, columns) == (2, ["environment", "depth", "trial", "longest"])
    assert "How long are the champions’ links?" in page or "How long are the champions&#39; links?" in page
    assert 'href="reach.csv"' in page and "longest link [m]" in page
    assert (
        (copy / "out" / "report" / "index.html" / "reach.csv").read_text().startswith("environment,depth,trial,longest")
    )
    pulled = np.array([round(PULL * 127 / MOST_ACCELERATION), 0])
    seen = pushes(copy)["tar_pit", "Tar Pit"]
    assert (seen == pulled).all(axis=1).any() and ((seen == pulled) | (seen == 0)).all()
    designs = tables["evolve"]
    bend, hollow, motors = (np.stack(designs[name].to_numpy()) for name in ("bend", "hollow", "motor_on"))
    assert (abs(bend) <= 1).all() and not bend[:, 0].any() and bend[:, 1:].all()
    assert len(set(hollow.sum(axis=1))) > 1
    assert (motors.sum(axis=1) == 2).all()  # a flag that is not a motor does not count as one
    assert designs["girth"].is_between(0.5, 2.0).all() and designs["girth"].n_unique() > 1
    scored = copy / "out" / "transfer" / "true_slush" / "1m" / "trial-0"
    before, after = (json.loads((scored / name).read_text()) for name in ("champion.json", "adapted.json"))
    assert (before["hollow"], before["girth"]) == (after["hollow"], after["girth"])
    assert before["bend"] != after["bend"]
