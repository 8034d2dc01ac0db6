"""`puddle compare`: on the terminal, as a page, and what it refuses."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from browser import Browser
from command_line import call, refused
from small_study import run, silent

from pipeline.cluster import serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.results.recorded_study import open_study
from pipeline.results.study_pair import pair_of
from pipeline.stages import STAGES
from pipeline.store.store import Store, StudyRecord
from pipeline.workflow.record import DrivenStudy
from tasks.analysis.comparison import difference, welch

BEFORE_ASSESSMENT = [stage.name for stage in STAGES].index("assess")


def changed(settings: Settings, *overrides: str) -> Settings:
    return parse(Settings, settings.model_dump_json(), name="tiny", overrides=overrides)


@pytest.fixture(scope="module")
def root(settings, tmp_path_factory) -> Path:
    """A store with two studies, each up to its transfer."""
    store = Store.open(tmp_path_factory.mktemp("compared") / "store", create=True)
    for name, seed in (("tiny", 1), ("other", 2)):
        own = changed(settings, f"name={name}", f"seed={seed}", f"evolution.n_generations={3 + seed}")
        with serial_cluster() as cluster:
            results = run(own, store, cluster, STAGES[:BEFORE_ASSESSMENT])
        DrivenStudy(own, store, silent).update(results, finished=True)
    return store.root


@pytest.fixture(scope="module")
def page(root, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("page") / "compare.html"
    assert call("compare", "tiny", "other", "--store", str(root), "--out", str(out)) == 0
    return out


def test_the_terminal_shows_settings_a_row_for_each_test_and_the_page(root, page, capsys):
    assert call("compare", "tiny", "other", "--store", str(root), "--out", str(page)) == 0
    said = capsys.readouterr().out
    lines = said.splitlines()
    assert lines[:2] == ["A: study tiny", "B: study other"]
    assert "  seed: 1 → 2" in lines and "  evolution.n_generations: 4 → 5" in lines
    assert sum(bool(re.match(r"  (predicted|zero-shot|adapted) ", line)) for line in lines) == 8
    assert lines[-1] == f"Open: {page.as_uri()}"
    assert max(map(len, lines[:-1])) <= 80


def test_the_numbers_are_those_of_the_champions(root):
    a, b = (open_study(name, root) for name in ("tiny", "other"))
    pair = pair_of(a, b)
    assert len(pair.differences) == 8  # zero-shot of four arms, predicted of three, adapted of Dry Land
    for row in pair.differences:
        x, y = (
            np.array(study.table("champions", environment=row.evolved_in, depth=1.0)[row.quantity]) for study in (a, b)
        )
        assert row.difference == difference(x, y, equal_variances=False) and row.clustered == welch(x, y)
    curve = a.table("fitness_curves", environment="dry_land", depth=1.0, trial=1)["best_fitness"]
    (shown,) = (t for t in pair.a.trials if (t.environment, t.trial) == ("dry_land", 1))
    np.testing.assert_array_equal(shown.curve, curve)


def test_trials_of_networks_have_the_replicates_of_their_study(settings, root, tmp_path, capsys):
    own = changed(settings, "name=replicated", "replicates=2")
    store = Store.open(root, create=False)
    with serial_cluster() as cluster:
        results = run(own, store, cluster, STAGES[:BEFORE_ASSESSMENT])
    DrivenStudy(own, store, silent).update(results, finished=True)
    pair = pair_of(*(open_study(name, root) for name in ("replicated", "other")))
    learned = ("residual_slush", "single_member")
    assert {(row.evolved_in in learned, row.a.n_replicates, row.b.n_replicates) for row in pair.differences} == {
        (True, 2, 1),
        (False, 1, 1),
    }
    out = tmp_path / "compare.html"
    assert call("compare", "replicated", "other", "--store", str(root), "--out", str(out)) == 0
    said = capsys.readouterr().out
    assert said.count("n = 2 and 2 in 2 and 1 replicates\n") == len(learned)
    assert "in 2, 1 replicates" in out.read_text()


def test_the_page_holds_settings_curves_transfer_and_tests(page, root):
    html = page.read_text()
    shown = re.sub(r"<style.*?</style>|<svg.*?</svg>", " ", html, flags=re.DOTALL)
    words = " ".join(re.sub(r"<[^>]+>", " ", shown).split())
    assert not re.search(r"\b(nan|NaN|inf|None)\b", words)
    assert re.findall(r'<section id="(\w+)">', html) == ["settings", "evolution", "transfer", "tests"]
    assert "evolution. n_generations 4 5" in words and "k differs" not in words
    assert html.count("<svg") == 2  # for a phone and for a desktop
    assert "Trials of A and B (n): True Slush 2 and 2; Dry Land 2 and 2" in words
    (tests,) = re.findall(r'<table class="tests">.*?</table>', html, flags=re.DOTALL)
    rows = re.findall(r"<tr>(<td.*?)</tr>", tests, flags=re.DOTALL)
    for row, made in zip(rows, pair_of(open_study("tiny", root), open_study("other", root)).differences, strict=True):
        assert made.judgement.verdict in row and f"{abs(made.difference.value):.1f}" in row
    assert not re.search(r'(src|href)="(?!#|data:)', html)  # it loads nothing


@pytest.mark.parametrize("width", [390, 768, 1920])
def test_the_page_fits_its_window(browser: Browser, page, width):
    browser.open(page, width=width)
    assert browser.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
    tables = "Array.from(document.querySelectorAll('.scroll'))"
    assert browser.evaluate(f"{tables}.every((one) => one.scrollWidth <= one.clientWidth)")
    assert browser.evaluate("[...document.querySelectorAll('figure svg')].filter((one) => one.clientWidth).length") == 1


def test_a_study_of_another_store(root, tmp_path, capsys):
    other = shutil.copytree(root, tmp_path / "elsewhere")
    assert call("compare", "tiny", "other", "--store", str(root), "--store-b", str(other)) == 0
    said = capsys.readouterr().out
    assert f"A: study tiny, in {root}\nB: study other, in {other}\n" in said


def test_a_group_that_no_setting_affects_is_not_tested(settings, root, tmp_path, capsys):
    own = changed(settings, "name=bold", "ensemble.disagreement_penalty=0")
    store = Store.open(root, create=False)
    with serial_cluster() as cluster:
        results = run(own, store, cluster, STAGES[:BEFORE_ASSESSMENT])
    DrivenStudy(own, store, silent).update(results, finished=True)
    out = tmp_path / "compare.html"
    assert call("compare", "bold", "tiny", "--store", str(root), "--out", str(out)) == 0
    assert "fitness is μ − kσ, and k differs between A and B" in out.read_text()
    said = capsys.readouterr().out
    rows = [line for line in said.splitlines() if line.startswith("  zero-shot")]
    assert ["–" in row for row in rows] == [True, True, False, True]  # all but the ensemble
    assert "2 of the trials are the same in both studies" in said


def test_curves_of_different_objectives_are_not_comparable(settings, root, tmp_path):
    own = changed(settings, "name=fast", "evolution.objective=second_half_speed")
    store = Store.open(shutil.copytree(root, tmp_path / "store"), create=False)
    with serial_cluster() as cluster:
        results = run(own, store, cluster, STAGES[:BEFORE_ASSESSMENT])
    DrivenStudy(own, store, silent).update(results, finished=True)
    out = tmp_path / "compare.html"
    assert call("compare", "fast", "tiny", "--store", str(store.root), "--out", str(out)) == 0
    page = out.read_text()
    assert "A’s fitness is speed in the second half, B’s is displacement: their curves can’t be compared." in page
    assert "best fitness [m/s and m]" in page


# -- bad input -------------------------------------------------------------------------------------------------------


@pytest.fixture
def copied(root, tmp_path) -> Store:
    return Store.open(shutil.copytree(root, tmp_path / "store"), create=False)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (
            ("slush.linear_drag=5", "rollout.n_measure=30"),
            "differ in what a displacement is (slush.linear_drag: 10.0 → 5.0; rollout.n_measure: 20 → 30): expected "
            "equal settings of physics, slush, rollout",
        ),
        (("physics.time_step=0.01",), "(physics.time_step: "),
        (
            ("grid.depths=[3, 4]",),
            "grid.depths: expected some in common, got 1 m in study tiny and 3, 4 m in study new",
        ),
        (
            ("grid.environments=[single_member]", "seed=3"),
            "study new has no champions: no trial has been transferred to True Slush yet",
        ),
        (("seed=3",), "study new has no champions: no trial has been transferred to True Slush yet"),
        (("work.generations_per_item=2",), "have the same settings and so the same trials: expected another seed"),
    ],
)
def test_studies_that_cannot_be_compared(copied, settings, overrides, message, capsys):
    own = changed(settings, "name=new", *overrides)
    copied.write_study(StudyRecord("new", own.model_dump(mode="json"), ()))
    said = refused(capsys, "compare", "tiny", "new", "--store", str(copied.root))
    assert message in said and len(said.splitlines()) == 1


def test_no_common_environment(copied, settings, capsys):
    for name, environment in (("wet", "true_slush"), ("dry", "dry_land")):
        own = changed(settings, f"name={name}", f"grid.environments=[{environment}]", "grid.single_member_depths=[]")
        copied.write_study(StudyRecord(name, own.model_dump(mode="json"), ()))
    said = refused(capsys, "compare", "wet", "dry", "--store", str(copied.root))
    assert "grid.environments: expected some in common, got true_slush in study wet and dry_land in study dry" in said


def test_one_study_twice_and_an_unknown_one(root, tmp_path, capsys):
    store = ("--store", str(root))
    assert "expected two studies, got study tiny twice" in refused(capsys, "compare", "tiny", "tiny", *store)
    assert f"study 'tin': {root} holds" in refused(capsys, "compare", "other", "tin", *store)
    nowhere = str(tmp_path / "nowhere")
    assert nowhere in refused(capsys, "compare", "tiny", "other", *store, "--store-b", nowhere)


def test_a_page_that_cannot_be_written(root, tmp_path, capsys):
    (tmp_path / "notes.html").write_text("what I found")
    (tmp_path / "folder.html").mkdir()
    os.mkfifo(tmp_path / "pipe.html")
    for name, message in (
        ("page.pdf", "expected a file name that ends in .html, in an existing folder"),
        ("missing/page.html", "expected a file name that ends in .html, in an existing folder"),
        ("notes.html", "is not an HTML page"),
        ("folder.html", "is not a regular file"),
        ("pipe.html", "is not a regular file"),
        ("x" * 300 + ".html", "can't write"),
    ):
        chosen = ("--store", str(root), "--out", str(tmp_path / name))
        said = refused(capsys, "compare", "tiny", "other", *chosen)
        assert message in said and len(said.splitlines()) == 1, name
    assert (tmp_path / "notes.html").read_text() == "what I found"
