"""``puddle fabricate``: the kit's folder, its page and its findings."""

import hashlib
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from command_line import call

from pipeline.bench.fabrication.kit_files import KIT_MANIFEST, read_timeline
from pipeline.bench.fabrication.source import as_built
from pipeline.bench.servo.play import Connection, User, play_timeline
from pipeline.commands.proposal import proposed
from pipeline.config.loading import load
from pipeline.results.recorded_study import open_study
from pipeline.store.design_file import design_json, load_design
from tasks.bench.fabrication.calibration import Calibration
from tasks.design import Designs
from tasks.simulation import simulate
from tasks.world import ResidualSlush

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def made(crane, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("fabricate")
    genes = {name: array.copy() for name, array in crane.arrays()}
    genes["motion_range"][:, 0] = 0.2
    (folder / "crane.json").write_bytes(design_json(Designs(**genes)))
    assert call("fabricate", str(folder / "crane.json"), "--out", str(folder / "kit")) == 0
    return folder


def test_a_kit_is_whole(made):
    kit = made / "kit"
    manifest = json.loads((kit / KIT_MANIFEST).read_text())
    held = {str(path.relative_to(kit)) for path in kit.rglob("*") if path.is_file()}
    assert held == {*manifest["files"], KIT_MANIFEST}
    for name, digest in manifest["files"].items():
        assert hashlib.sha256((kit / name).read_bytes()).hexdigest() == digest
    assert {"timeline.json", "design.json", "assembly.md", "servo.md", "servo-wiring.svg"} <= held
    assert load_design(kit / "design.json") == load_design(made / "crane.json")
    page = (kit / "index.html").read_text()
    severities = [finding["severity"] for finding in manifest["findings"]]
    assert set(severities) == {"warning"} and f"No fault, but {len(severities)} warning" in page
    links = set(re.findall(r"""(?:href|src)=["']([^"'#:]+)["']""", page))
    assert len(links) > 20 and [link for link in links if not (kit / link).exists()] == []
    for said in ("Froude", "70 mm", "0.265 s", "30 N·m", "1.13 Hz", "ds3225", "No ensemble", "floats"):
        assert said in page, said


def test_the_page_in_a_browser(made, browser):
    width = 390
    browser.open(made / "kit/index.html", width=width)
    browser.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    hidden = browser.evaluate("[...document.querySelectorAll('.scroll')].map((t) => t.scrollWidth - t.clientWidth)")
    assert len(hidden) >= 6 and max(hidden) <= 0
    assert browser.evaluate("[...document.images].every((i) => i.complete && i.naturalWidth > 100)")
    assert not browser.named("Log.entryAdded") and not browser.named("Runtime.exceptionThrown")


def test_its_timeline_and_calibration_can_be_played(made, clock, tmp_path):
    line, servos = read_timeline(made / "kit/timeline.json"), load(Calibration, made / "kit/calibration.yaml")
    assert line.joints == (2, 4) and line.time[-1] == 150.0
    assert {servo.joint for servo in servos.servos} == {2, 4}
    # 0.2 Hz under Froude's law: the second joint swings by 0.8 rad at 0.756 Hz.
    swing = line.angle[(line.time > 10) & (line.time < 140), 1]
    crossings = np.flatnonzero((swing[:-1] < 0) & (swing[1:] >= 0))
    assert np.diff(crossings).mean() / 50 == pytest.approx(np.sqrt(0.07) / 0.2, rel=2e-3)
    assert np.abs(swing).max() == pytest.approx(0.8, abs=0.01)
    user = User(confirm=lambda question: True, say=lambda line: None)
    assert play_timeline(made / "kit", Connection(dry_run=True), user, log=tmp_path / "dry.csv", clock=clock)


def test_a_servo_that_is_too_weak_is_flagged_and_the_kit_replaced(made, tmp_path, capsys):
    shutil.copytree(made / "kit", tmp_path / "kit")
    arguments = (str(made / "crane.json"), "--out", str(tmp_path / "kit"), "--preset", "laptop")
    assert call("fabricate", *arguments, "--set", "kit.servo=mg90s", "--set", "kit.horn=cross") == 1
    said = capsys.readouterr().out
    assert "fault    joint" in said and "too weak or too slow" in said and "mg90s" in said
    kinds = [line.split()[0] for line in said.splitlines()]
    counts = f"{kinds.count('fault')} faults and {kinds.count('warning')} warnings"
    assert said.splitlines()[-1].startswith(f"Do not build this kit: {counts}. ")
    page = (tmp_path / "kit/index.html").read_text()
    assert f"Do not build this kit: {counts}." in page and "mg90s" in page


def test_mistakes(made, tmp_path, capsys):
    design, out = str(made / "crane.json"), ("--out", str(tmp_path / "kit"))
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "thesis.tex").write_text("mine")
    for arguments, said in (
        ((), "either a design file or --study"),
        ((design, "--study", "pontoon"), "either a design file or --study"),
        (("--study", "raft", "--preset", "laptop", *out), "--preset"),
        ((design, *out, "--set", "kit.servo=ds9999"), "ds3225"),
        ((design, "--set", "kit.servos=1"), "kit.servos: unknown setting"),
        ((design, "--out", str(tmp_path / "thesis")), "thesis: expected a new folder or a kit"),
        ((design, "--out", str(tmp_path / "none" / "kit")), "kit: expected a new folder or a kit"),
    ):
        assert call("fabricate", *arguments) == 2
        assert said in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["thesis", "thesis.tex"]


def test_the_proposed_champion_of_a_study(recorded):
    study = open_study("tiny", recorded)
    source = proposed(study)
    rows = [row for row in study.champions().to_pylist() if row["environment"] == "residual_slush"]
    scores = np.array([row["zero_shot"] for row in rows])
    nearest = rows[int(np.argmin(np.abs(scores - scores.mean())))]
    assert source.name == f"tiny-trial-{nearest['trial']}" and source.depth == 1.0 and len(source.predicted) == 2
    design, rollout = study.champion("residual_slush", depth=1.0, trial=nearest["trial"]), study.settings.rollout
    locked = {"physics": as_built(study.settings.physics), **rollout.model_dump()}  # as a kit has it
    moved = simulate(design, ResidualSlush(1.0, study.ensemble()), **locked).displacement
    np.testing.assert_array_equal(source.predicted, moved[:, 0])
