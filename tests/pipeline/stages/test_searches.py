"""Studies by other searches than the paper's: the same stages, files and tables; their keys differ."""

import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from small_study import run

from pipeline.cluster import serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings, WorkSettings
from pipeline.results.recorded_study import Study, open_study
from pipeline.stages import STAGES
from pipeline.store.store import Store
from pipeline.workflow.record import DrivenStudy
from pipeline.workflow.stage import AnyStage
from tasks.evolution import require_search

SETTINGS = """
name: tiny
grid: {depths: [1.0], environments: [true_slush], single_member_depths: [], n_trials: 2}
rollout: {n_settle: 5, n_measure: 20}
evolution: {n_generations: 4, SEARCH: {population_size: 6}, search: SEARCH}
transfer: {n_generations: 2}
assess: {n_designs: 4}
work: {generations_per_item: 2}
"""

OPERATORS = {"map_elites": {"random", "mutation", "crossover"}, "cma_es": {"random", "sample"}}


TO_TRANSFER = STAGES[:5]


def recorded(settings: Settings, root: Path, stages: Sequence[AnyStage] = TO_TRANSFER) -> Study:
    store = Store.open(root, create=True)
    with serial_cluster() as cluster:
        upstream = run(settings, store, cluster, stages)
    assert not any(results.failed for results in upstream.values())
    DrivenStudy(settings, store, print).update(upstream)
    return open_study("tiny", root)


@pytest.mark.parametrize("search", OPERATORS)
def test_a_study_by_another_search(search, tmp_path):
    """Its histories say what made each design, and do not depend on how the work is divided."""
    settings = parse(Settings, SETTINGS.replace("SEARCH", search), name="tiny")
    study = recorded(settings, tmp_path / "store", STAGES if search == "map_elites" else TO_TRANSFER)
    histories = study.table("histories")
    assert histories.num_rows == 2 * 4 * 6
    assert set(histories["operator"].to_pylist()) <= OPERATORS[search]
    assert ("body_size" in histories.column_names) == (search == "map_elites")
    if search == "map_elites":
        files = [name for (done,) in study.upstream["report"].done.values() for name in done.files]
        assert {"elites.svg", "elites.csv"} <= set(files)
        fittest = study.table("elites").group_by("trial").aggregate([("fitness", "max")])
        assert sorted(fittest["fitness_max"].to_pylist()) == sorted(study.champions()["fitness"].to_pylist())
        cells = zip(*(study.table("elites")[name].to_pylist() for name in ("length_cell", "size_cell")), strict=True)
        assert {f"elite-{i}-{j}.json" for i, j in cells} == {name for name in files if name.startswith("elite-")}
    work = WorkSettings(generations_per_item=4, engine="reference")
    whole = recorded(settings.model_copy(update={"work": work}), tmp_path / "whole")
    for name in ("histories", "adaptations"):
        assert study.table(name).equals(whole.table(name))


def test_a_search_without_its_package_is_refused(monkeypatch):
    monkeypatch.setitem(sys.modules, "ribs", None)  # which is how Python says that it can't be imported
    with pytest.raises(ValueError, match=r"search is map_elites.*expected the package ribs.*puddle\[search\]"):
        require_search("map_elites")
