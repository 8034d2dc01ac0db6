"""`puddle compare`: two studies or two arms, on the terminal and in every kind of file, and what it refuses."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from browser import Browser
from command_line import call, refused
from scipy import stats
from small_study import run, silent

from pipeline.cluster import serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.results.comparisons import compare_arms, compare_studies
from pipeline.results.recorded_study import open_study
from pipeline.stages import STAGES
from pipeline.store.store import Store, StudyRecord
from pipeline.workflow.record import DrivenStudy

BEFORE_ASSESSMENT = [stage.name for stage in STAGES].index("assess")


def changed(settings: Settings, *overrides: str) -> Settings:
    return parse(Settings, settings.model_dump_json(), name="tiny", overrides=overrides)


@pytest.fixture(scope="module")
def root(settings, recorded, tmp_path_factory) -> Path:
    """A store with the shared study, and another, of other physics, up to its transfer."""
    root = shutil.copytree(recorded, tmp_path_factory.mktemp("compared") / "store")
    other = changed(settings, "name=other", "seed=2", "evolution.n_generations=5", "slush.linear_drag=5")
    store = Store.open(root, create=False)
    with serial_cluster() as cluster:
        results = run(other, store, cluster, STAGES[:BEFORE_ASSESSMENT])
    DrivenStudy(other, store, silent).update(results)
    return root


@pytest.fixture(scope="module")
def page(root, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("page") / "compare.html"
    assert call("compare", "tiny", "other", "--store", str(root), "--out", str(out)) == 0
    return out


def test_the_terminal_shows_settings_and_a_row_for_each_test(root, capsys):
    assert call("compare", "tiny", "other", "--store", str(root)) == 0
    said = capsys.readouterr().out
    lines = said.splitlines()
    assert lines[0] == "A: study tiny; B: study other, the reference"
    assert "  seed: 1 → 2" in lines and "  evolution.n_generations: 4 → 5" in lines
    assert "8 comparisons: " in lines[-1]
    assert "They differ in what a displacement is: slush.linear_drag." in said


def test_the_numbers_are_those_of_the_champions(root):
    a, b = (open_study(name, root) for name in ("tiny", "other"))
    rows = compare_studies(a, b).rows
    assert len(rows) == 8  # zero-shot of four arms, predicted of three, adapted of Dry Land
    for row in rows:
        assert row.a == row.b
        arm, quantity = row.a.split("/")
        x, y = (np.array(study.table("champions", environment=arm, depth=1.0)[quantity]) for study in (a, b))
        assert row.difference.value == pytest.approx(x.mean() - y.mean(), rel=1e-12)
        assert row.p == pytest.approx(stats.ttest_ind(x, y, equal_var=False).pvalue, rel=1e-9)


def test_two_arms_of_a_study_are_compared_in_every_kind_of_file(root, tmp_path, capsys):
    arms = ("--arms", "residual_slush", "dry_land", "--store", str(root))
    (row,) = (row for row in compare_arms(open_study("tiny", root), *arms[1:3]).rows if row.a.endswith("zero_shot"))
    for suffix in (".html", ".md", ".tex", ".csv", ".json"):
        out = tmp_path / f"arms{suffix}"
        assert call("compare", "tiny", *arms, "--out", str(out)) == 0
        assert row.verdict in capsys.readouterr().out and row.verdict in out.read_text()
        assert f"got {out}" in refused(capsys, "compare", "tiny", *arms, "--out", str(out))
    (listed,) = (one for one in json.loads((tmp_path / "arms.json").read_text()) if one["a"].endswith("zero_shot"))
    assert listed["difference"] == row.difference.value and listed["p"] == row.p


def test_the_page_holds_settings_and_tests_and_loads_nothing(page):
    html = page.read_text()
    words = " ".join(re.sub(r"<[^>]+>", " ", re.sub(r"<style.*?</style>", " ", html, flags=re.DOTALL)).split())
    assert not re.search(r"\b(nan|NaN|inf|None)\b", words)
    assert "evolution.n_generations 4 5" in words
    assert html.count("<tr>") > 8 and not re.search(r'(src|href)="(?!#|data:)', html)


@pytest.mark.parametrize("width", [390, 1920])
def test_the_page_fits_its_window(browser: Browser, page, width):
    browser.open(page, width=width)
    assert browser.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0


# -- bad input -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("tiny",), "expected two studies, or one study and --arms A B"),
        (("tiny", "other", "--arms", "dry_land", "true_slush"), "expected two studies, or one study and --arms A B"),
        (("tiny", "tiny"), "expected two studies, got study tiny twice"),
        (("other", "tin"), "study 'tin': "),
        (("tiny", "--arms", "dry_land", "mud"), "got 'mud'"),
        (("tiny", "--arms", "dry_land", "dry_land"), "--arms: expected two arms, got dry_land twice"),
        (("tiny", "other", "--out", "missing/page.html"), "in an existing folder"),
        (("tiny", "other", "--out", "page.pdf"), "expected a new file that ends in .html or .md"),
        (("tiny", "new"), "at the same depth: expected some in both, got"),
    ],
)
def test_what_is_refused(root, settings, tmp_path, words, message, capsys):
    store = Store.open(shutil.copytree(root, tmp_path / "store"), create=False)
    own = changed(settings, "name=new", "seed=3")
    store.write_study(StudyRecord("new", own.model_dump(mode="json"), ()))
    said = refused(capsys, "compare", *words, "--store", str(store.root))
    assert message in said and len(said.splitlines()) == 1
