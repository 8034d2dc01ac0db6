import csv
import io
import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from command_line import call, refused

from pipeline.results.recorded_study import open_study
from tasks.simulation import simulate
from tasks.world import TrueSlush


@pytest.fixture(scope="module")
def designs(recorded, tmp_path_factory):
    path = tmp_path_factory.mktemp("designs") / "designs.parquet"
    histories = open_study("tiny", recorded).table("histories", environment="residual_slush", trial=0)
    pq.write_table(histories, path)
    return path


def test_designs_of_a_history_score_again_what_it_says(recorded, designs, tmp_path, capsys):
    """Under the same networks, to the last bit."""
    before, out = pq.read_table(designs), tmp_path / "scores.parquet"
    at = ["--environment", "residual_slush", "--depth", "1", "--study", "tiny", "--store", str(recorded)]
    assert call("score", str(designs), *at, "--out", str(out)) == 0
    scores = pq.read_table(out)
    for name in ("fitness", "displacement", "com_displacement"):
        np.testing.assert_array_equal(scores[name].to_pylist(), before[name].to_pylist())
    assert scores["identity"].to_pylist() == before["identity"].to_pylist()  # what was read is there, too
    assert {*before.column_names} < {*scores.column_names}
    said = capsys.readouterr().out
    assert f"Residual Slush, 1 m deep: {len(before)} designs, 0 diverged" in said and str(out) in said


def test_scores_in_the_target_need_no_store(recorded, designs, tmp_path):
    champions = open_study("tiny", recorded).champions().select(["trial", "design_json"])
    champions = champions.append_column("note", pa.array([None, *["lively"] * (len(champions) - 1)]))
    pq.write_table(champions, tmp_path / "champions.parquet")
    (tmp_path / "tiny.json").write_text(json.dumps({"name": "tiny", "rollout": {"n_settle": 5, "n_measure": 20}}))
    out = tmp_path / "scores.CSV"
    at = ["--depth", "1", "--settings", str(tmp_path / "tiny.json")]
    assert call("score", str(tmp_path / "champions.parquet"), *at, "--out", str(out)) == 0
    rows = list(csv.DictReader(io.StringIO(out.read_text())))
    assert [*rows[0]] == [*champions.column_names, "design", "diverged", "fitness", "displacement", "com_displacement"]
    assert [int(row["trial"]) for row in rows] == champions["trial"].to_pylist()
    assert [row["note"] for row in rows] == ["", *["lively"] * (len(champions) - 1)]
    champion = open_study("tiny", recorded).champion("true_slush", depth=1.0, trial=0)
    again = simulate(champion, TrueSlush(depth=1.0), n_settle=5, n_measure=20).displacement[0]
    assert float(rows[0]["displacement"]) == pytest.approx(again, rel=1e-12)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--environment", "mud", "--depth", "1"], "--environment: expected one of"),
        (["--environment", "dry_land", "--depth", "-1"], "--depth: expected 0 to 1000 m, got -1"),
        (["--environment", "dry_land", "--depth", "1", "--out", "/nosuch/x.csv"], "ends in .parquet or .csv"),
        (["--environment", "dry_land", "--depth", "1", "--out", "scores.txt"], "ends in .parquet or .csv"),
        (["--environment", "residual_slush", "--depth", "1", "--store", "/nosuch"], "/nosuch"),
        (["--depth", "1", "--engine", "bullet"], "engine is 'bullet', expected any of batch, reference, mujoco"),
    ],
)
def test_bad_arguments(designs, capsys, arguments, said):
    assert said in refused(capsys, "score", str(designs), *arguments)


def test_the_designs_are_not_overwritten(designs, capsys):
    before, at = designs.read_bytes(), ("--environment", "dry_land", "--depth", "1")
    said = refused(capsys, "score", str(designs), *at, "--out", str(designs))
    assert "expected another file than the designs'" in said and designs.read_bytes() == before
