"""``puddle fabricate``: the kit's folder, its page and its findings."""

import hashlib
import json
import re
import shutil
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from command_line import call

from pipeline.errors import PuddleError
from pipeline.fabrication.bench import Bench
from pipeline.fabrication.kit_files import KIT, KIT_MANIFEST, read_calibration, read_timeline, write_folder
from pipeline.fabrication.kit_page import TEMPLATES, verdict
from pipeline.fabrication.make_kit import fabricate
from pipeline.servo.play import PlayOptions, play_timeline
from pipeline.store import disk
from pipeline.store.design_file import design_document, read_design
from pipeline.store.store import Store
from tasks.design import Designs
from tasks.fabrication.checks import KitFinding
from tasks.fabrication.kit_settings import FabricationSettings


def write(design: Designs, path: Path) -> Path:
    genes = {name: array.copy() for name, array in design.arrays()}
    genes["motion_range"][:, 0] = 0.2
    path.write_text(json.dumps(design_document(Designs(**genes))))
    return path


@pytest.fixture(scope="module")
def made(crane, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("fabricate")
    design = write(crane, folder / "crane.json")
    assert call("fabricate", str(design), "--out", str(folder / "kit"), "--store", str(folder / "store")) == 0
    return folder


def test_a_kit_is_whole(made):
    kit = made / "kit"
    mark = json.loads((kit / KIT_MANIFEST).read_text())
    held = {str(path.relative_to(kit)) for path in kit.rglob("*") if path.is_file()}
    assert held == {*mark["files"], KIT_MANIFEST}
    for name, digest in mark["files"].items():
        assert hashlib.sha256((kit / name).read_bytes()).hexdigest() == digest
    assert {
        "index.html",
        "robot.png",
        "drawing.svg",
        "bill.csv",
        "timeline.csv",
        "calibration.yaml",
        "design.json",
        "assembly.md",
        "servo.md",
        "servo-wiring.svg",
        "print/part-1-left.stl",
    } <= held
    assert read_design(kit / "design.json").equals(read_design(made / "crane.json"))
    assert mark["metrics"]["n_faults"] == 0
    assert sorted(path.name for path in made.iterdir()) == ["crane.json", "kit", "store"]


def test_its_timeline_and_calibration_can_be_played(made, clock, tmp_path):
    line, servos = read_timeline(made / "kit/timeline.json"), read_calibration(made / "kit/calibration.yaml")
    assert line.joints == (2, 4) and line.time[-1] == 150.0
    assert {servo.joint for servo in servos.servos} == {2, 4}
    # 0.2 Hz under Froude's law: the second joint swings by 0.8 rad at 0.756 Hz.
    swing = line.angle[(line.time > 10) & (line.time < 140), 1]
    crossings = np.flatnonzero((swing[:-1] < 0) & (swing[1:] >= 0))
    assert np.diff(crossings).mean() / 50 == pytest.approx(np.sqrt(0.07) / 0.2, rel=2e-3)
    assert np.abs(swing).max() == pytest.approx(0.8, abs=0.01)
    options = PlayOptions(made / "kit", dry_run=True, log=tmp_path / "dry.parquet")
    assert play_timeline(options, confirm=lambda question: True, say=lambda line: None, clock=clock)


def test_every_link_of_the_page_leads_somewhere(made):
    page = (made / "kit/index.html").read_text()
    manifest = json.loads((made / "kit" / KIT_MANIFEST).read_text())
    n_warnings = sum(finding["severity"] == "warning" for finding in manifest["findings"])
    assert n_warnings and f"No fault, but {n_warnings} warning" in page
    links = set(re.findall(r"""(?:href|src)=["']([^"'#:]+)["']""", page))
    assert len(links) > 25 and [link for link in links if not (made / "kit" / link).exists()] == []
    for said in ("Froude", "70 mm", "0.265 s", "30 N·m", "1.13 Hz", "ds3225", "No ensemble", "floats"):
        assert said in page, said


@pytest.mark.parametrize("width", [1200, 390])
def test_the_page_in_a_browser(made, browser, width):
    browser.open(made / "kit/index.html", width=width)
    browser.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    tables = browser.evaluate(
        "[...document.querySelectorAll('.scroll')].map((t) => [t.closest('section').querySelector('h2').textContent,"
        " t.scrollWidth - t.clientWidth])"
    )
    assert len(tables) >= 6 and [name for name, hidden in tables if hidden > 0] == []
    clipped = browser.evaluate(
        "[...document.querySelectorAll('td, li, figcaption')].filter((e) => e.scrollWidth > e.clientWidth + 1)"
        ".map((e) => e.textContent)"
    )
    assert clipped == []
    assert browser.evaluate("[...document.images].every((i) => i.complete && i.naturalWidth > 100)")
    for name in ("torque", "gait"):  # the legend stands above the axes, and hides no data
        legend, axes = (
            f"document.querySelector('#{name} [id*={part}]').getBoundingClientRect()"
            for part in ("legend_1", "patch_2")
        )
        assert browser.evaluate(f"{legend}.bottom - {axes}.top") <= 1.0
    pixels = browser.picture(".picture img").astype(int)
    assert (pixels.max(axis=2) - pixels.min(axis=2) > 60).mean() > 0.02  # the robot's colours
    assert not browser.named("Log.entryAdded") and not browser.named("Runtime.exceptionThrown")


def test_mlflow_holds_the_kit(made):
    from mlflow.tracking import MlflowClient

    client = MlflowClient(f"sqlite:///{made / 'store/mlflow.db'}")
    (experiment,) = client.search_experiments(filter_string="name = 'puddle'")
    runs = {run.info.run_name: run for run in client.search_runs([experiment.experiment_id])}
    run = runs["fabricate"]
    assert run.data.metrics["margin.joint_2"] > 1 and run.data.params["kit.servo"] == "ds3225"
    logged = {
        file.path
        for name in ("kit", "kit/print", "kit/cad", "kit/profiles")
        for file in client.list_artifacts(run.info.run_id, name)
    }
    page = (made / "kit/index.html").read_text()
    links = re.findall(r"""(?:href|src)=["']([^"'#:]+[^"'#:/])["']""", page)
    assert "print/part-1-left.stl" in links and {f"kit/{link}" for link in links} <= logged


def test_a_servo_that_is_too_weak_is_flagged_and_the_kit_replaced(made, tmp_path, capsys):
    shutil.copytree(made / "kit", tmp_path / "kit")
    arguments = [str(made / "crane.json"), "--out", str(tmp_path / "kit"), "--store", str(made / "store")]
    assert call("fabricate", *arguments, "--set", "kit.servo=mg90s", "--set", "kit.horn=cross") == 1
    said = capsys.readouterr().out
    assert "fault    joint" in said and "too weak or too slow" in said and "mg90s" in said
    kinds = [line.split()[0] for line in said.splitlines()]
    counts = f"{kinds.count('fault')} faults and {kinds.count('warning')} warnings"
    assert said.splitlines()[-1].startswith(f"Do not build this kit: {counts}. ")
    page = (tmp_path / "kit/index.html").read_text()
    assert f"Do not build this kit: {counts}." in page and "mg90s" in page
    assert sorted(path.name for path in tmp_path.iterdir()) == ["kit"]


def test_the_design_in_the_readme_has_no_fault_and_a_timeline(made, tmp_path, clock, capsys):
    design = Path(__file__).parents[3] / "docs/design-buildable.json"
    arguments = [str(design), "--out", str(tmp_path / "kit"), "--store", str(made / "store")]
    assert call("fabricate", *arguments) == 0
    assert not any(line.startswith("fault") for line in capsys.readouterr().out.splitlines())
    options = PlayOptions(tmp_path / "kit", dry_run=True)
    assert play_timeline(options, confirm=lambda question: True, say=lambda line: None, clock=clock)


@pytest.mark.parametrize(
    ("severities", "expected"),
    [
        ("", "No fault and no warning was found."),
        ("note", "No fault and no warning was found."),
        ("warning", "No fault, but 1 warning: read it before you build."),
        ("warning warning note", "No fault, but 2 warnings: read them before you build."),
        ("fault", "Do not build this kit: 1 fault."),
        ("fault fault warning note", "Do not build this kit: 2 faults and 1 warning."),
    ],
)
def test_the_verdict_names_faults_and_warnings(severities, expected):
    findings = [KitFinding("name", severity, "joint 2", "message") for severity in severities.split()]
    assert verdict(findings) == expected


def test_a_kit_without_a_timeline_does_not_suggest_to_play_it(made):
    page = (made / "kit/index.html").read_text()
    assert "puddle servo play kit --dry-run" in page and "Measure each servo's pulses" in page
    lame = Bench(**{field.name: None for field in fields(Bench)} | {"calibration": object()})
    last_steps = TEMPLATES.get_template("kit_macros.html").module.last_steps
    steps = last_steps(lame, "kit")
    assert "puddle servo play" not in steps and "Measure each servo's pulses" in steps
    assert last_steps(replace(lame, calibration=None), "kit") == ""


def test_mistakes(made, crane, tmp_path, capsys):
    def refused(*arguments: str) -> str:
        assert call("fabricate", *arguments, "--store", str(made / "store")) == 2
        return capsys.readouterr().err

    design = str(made / "crane.json")
    assert "either a design file or --study" in refused()
    assert "either a design file or --study" in refused(design, "--study", "pontoon")
    assert "--preset" in refused("--study", "raft", "--preset", "laptop", "--out", str(tmp_path / "kit"))
    assert "study 'raft': " in refused("--study", "raft", "--out", str(tmp_path / "kit"))
    assert "ds3225" in refused(design, "--out", str(tmp_path / "kit"), "--set", "kit.servo=ds9999")
    assert "kit.servos: unknown setting" in refused(design, "--set", "kit.servos=1")
    assert "froude" in refused(design, "--set", "scaling.law=reynolds")
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "thesis.tex").write_text("mine")
    assert "thesis.tex" in refused(design, "--out", str(tmp_path / "thesis"))
    assert "does not exist" in refused(design, "--out", str(tmp_path / "none" / "kit"))
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["thesis", "thesis.tex"]


def test_a_kit_takes_the_range_of_motion_for_an_amplitude(settings, tmp_path):
    physics = settings.physics.model_copy(update={"range_of_motion": "peak_to_peak"})
    other = settings.model_copy(update={"physics": physics})
    store = Store.open(tmp_path / "store", create=True)
    with pytest.raises(PuddleError, match=r"physics\.range_of_motion is peak_to_peak"):
        fabricate(None, other, FabricationSettings(), tmp_path / "kit", store=store, tracker=None)
    assert not (tmp_path / "kit").exists()


def test_a_failing_disk_leaves_the_previous_kit(tmp_path, monkeypatch):
    folder = tmp_path / "kit"
    write_folder(KIT, folder, {"a.txt": b"old", "print/b.txt": b"old"}, {"name": "old"})
    left = 0

    def counted(effect):
        def failing(*arguments):
            nonlocal left
            left -= 1
            if left == 0:
                raise OSError(28, "No space left on device")
            return effect(*arguments)

        return failing

    for name in ("write", "fsync", "rename"):
        monkeypatch.setattr(disk, name, counted(getattr(disk, name)))
    for first_failure in range(1, 9):  # three files are written and flushed, then two renames
        left = first_failure
        with pytest.raises(PuddleError, match="No space left"):
            write_folder(KIT, folder, {"a.txt": b"new", "print/b.txt": b"new"}, {"name": "new"})
        assert (folder / "a.txt").read_bytes() == (folder / "print/b.txt").read_bytes() == b"old"
        assert [path.name for path in tmp_path.iterdir()] == ["kit"]
    left = 0
    write_folder(KIT, folder, {"a.txt": b"new"}, {"name": "new"})
    assert (folder / "a.txt").read_bytes() == b"new" and not (folder / "print").exists()


@pytest.mark.parametrize("after", [False, True])
def test_an_interrupt_leaves_the_previous_kit(tmp_path, monkeypatch, after):
    folder = tmp_path / "kit"
    write_folder(KIT, folder, {"a.txt": b"old"}, {"name": "old"})
    (folder / "servo-1.parquet").write_bytes(b"log")
    left = 0

    def counted(effect):
        def interrupted(*arguments):
            nonlocal left
            left -= 1
            if left == 0 and not after:
                raise KeyboardInterrupt
            effect(*arguments)
            if left == 0:
                raise KeyboardInterrupt

        return interrupted

    for name in ("write", "fsync", "rename"):
        monkeypatch.setattr(disk, name, counted(getattr(disk, name)))
    for n in range(1, 10):  # three files are written and flushed, then two renames, and their folder is flushed
        left = n
        with pytest.raises(KeyboardInterrupt):
            write_folder(KIT, folder, {"a.txt": b"new"}, {"name": "new"})
        assert (folder / "a.txt").read_bytes() == b"old" and (folder / "servo-1.parquet").read_bytes() == b"log"
        assert [path.name for path in tmp_path.iterdir()] == ["kit"]


def test_files_of_the_user_are_preserved(tmp_path):
    folder = tmp_path / "kit"
    made = {"calibration.yaml": b"a guess", "print/gone.stl": b"part", "design.json": b"{}"}
    assert write_folder(KIT, folder, made, {"name": "old"}) == []
    for content in (b"measured", b"measured again"):
        (folder / "calibration.yaml").write_bytes(content)
        (folder / "servo-1.parquet").write_bytes(b"log")
        lines = write_folder(KIT, folder, {"calibration.yaml": b"another guess", "design.json": b"{}"}, {"name": "new"})
    assert lines == [
        "Preserved calibration-yours-1.yaml.",
        "Preserved calibration.yaml, which you had changed, as calibration-yours-2.yaml.",
        "Preserved servo-1.parquet.",
    ]
    held = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    held.pop(KIT_MANIFEST)
    assert held == {
        "calibration.yaml": b"another guess",
        "calibration-yours-1.yaml": b"measured",
        "calibration-yours-2.yaml": b"measured again",
        "servo-1.parquet": b"log",
        "design.json": b"{}",
    }


def test_folders_that_are_refused(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    (tmp_path / "link").symlink_to(tmp_path)
    for name in ("file", "link"):
        with pytest.raises(PuddleError, match="a file or a link"):
            KIT.check_place(tmp_path / name)
    (tmp_path / "newer").mkdir()
    (tmp_path / "newer" / KIT_MANIFEST).write_text('{"schema": "puddle.kit", "version": 9}')
    with pytest.raises(PuddleError, match="version 9"):
        KIT.check_place(tmp_path / "newer")
    (tmp_path / "empty").mkdir()
    for name in ("empty", "newer/../empty"):
        assert KIT.check_place(tmp_path / name) == tmp_path / "empty"
    monkeypatch.chdir(tmp_path / "empty")
    with pytest.raises(PuddleError, match="can't replace the current directory"):
        KIT.check_place(Path())
