from __future__ import annotations

import json
import re
import shlex
from dataclasses import replace
from functools import partial
from html import unescape
from html.parser import HTMLParser

import numpy as np
import pytest
from command_line import call

from pipeline.report.data import StudyReport, TrialResult
from pipeline.report.downloads import tables_of
from pipeline.report.drawing import finish
from pipeline.report.figures import FIGURES, draw_all
from pipeline.report.findings import Findings
from pipeline.report.page import render_page, render_robot
from pipeline.report.replay import Overlay
from tasks.world import ENVIRONMENTS

VOID = {"meta", "link", "br", "input", "img", "hr"}
FETCHES = {"src", "srcset", "href", "xlink:href", "data", "action", "poster"}


class Page(HTMLParser):
    """The page taken apart: ids, what it would fetch, the text of its scripts, its words, and what was left open."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.references: list[str] = []
        self.scripts: dict[str, str] = {}
        self.words: list[str] = []
        self.open: list[str] = []
        self._script: str | None = None
        self.feed(html)

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        self.ids += [found["id"]] if "id" in found else []
        self.references += [value for name, value in attributes if name in FETCHES]
        self.references += re.findall(r"url\((.*?)\)", found.get("style") or "")
        if tag == "script":
            self._script = found.get("id", "viewer")
            self.scripts[self._script] = ""
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        self._script = None

    def handle_data(self, data):
        if self._script is not None:
            self.scripts[self._script] += data
        else:
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def html(study, drawn) -> str:
    return render_page(study, drawn)


def test_it_is_whole_and_every_id_is_its_own(html):
    page = Page(html)
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))


def test_nothing_is_fetched(html, study, drawn):
    """Links lead to places of the page, or to files beside it that the study writes."""
    page = Page(html)
    outside = {reference for reference in page.references if not reference.startswith(("#", "data:"))}
    figures = {f"{name}.{kind}" for name in drawn for kind in ("svg", "png")}
    assert outside == {"replay.mp4", "replay.gif", *figures, *tables_of(study)}
    assert not re.search(r'<(?!a)[^>]* href="[^#d]', html)
    assert "url(" not in html.replace("url(#", "")
    assert "@import" not in html
    assert not re.search(r"https?://", html)
    assert "default-src 'none'" in html
    targets = {reference[1:].partition(":")[0] for reference in page.references if reference.startswith("#")}
    assert targets <= set(page.ids) | {replay.robot for replay in study.replays}


def test_it_says_what_each_environment_of_the_study_is(study, drawn):
    of_study = ("true_slush", "designed_throws")
    page = unescape(render_page(replace(study, environments=of_study), drawn))
    said = {name: kind.about for name, kind in ENVIRONMENTS.items() if kind.about}
    assert [name for name, about in said.items() if f"<dd>{about}</dd>" in page] == list(of_study)


def test_the_viewer_finds_its_controls_and_its_robots(html, study):
    page = Page(html)
    code = without_comments(page.scripts["viewer"])
    asked_for = set(re.findall(r"""(?:control|getElementById)\("(\w+)"\)""", code))
    assert asked_for >= {"replays", "stage", "choice", "play", "scrub", "speed", "follow", "time"}
    assert asked_for <= set(page.ids)
    replays = json.loads(page.scripts["replays"])
    read = set(re.findall(r"\b(?:encoded|replay)\.(\w+)\b(?!\()", code))
    made_by_the_viewer = {"poses", "nLinks", "nFrames", "duration", "start", "center", "centers", "extent"}
    assert read - made_by_the_viewer <= set(replays[0])
    assert len(replays) == len(study.replays)
    robots = re.search(r'<select id="choice">(.*?)</select>', html, re.DOTALL)[1]
    assert sorted(map(int, re.findall(r'<option value="(\d+)"', robots))) == list(range(len(replays)))


def without_comments(code: str) -> str:
    return re.sub(r"//[^\n]*", "", code)


def test_brackets_of_the_viewer_match(html):
    """Not a parser, but it catches a cut or a slip: brackets outside strings and comments close in order."""
    code = without_comments(Page(html).scripts["viewer"])
    code = re.sub(r'"(?:\\.|[^"\\\n])*"', "", code)
    stack = []
    for character in code:
        if character in "([{":
            stack.append(character)
        elif character in ")]}":
            assert stack and stack.pop() + character in ("()", "[]", "{}")
    assert stack == []


def test_the_first_robot_shown_is_the_deepest_with_residuals(html, study):
    chosen = int(re.search(r'<option value="(\d+)" selected>', html)[1])
    assert (study.replays[chosen].environment, study.replays[chosen].depth) == ("residual_slush", 9.0)


def rows(html: str) -> list[list[str]]:
    table = html[html.index('<table class="transfer">') : html.index("</table>")]
    return [
        [re.sub(r"<[^>]+>", " ", cell).split() for cell in re.findall(r"<td>(.*?)</td>", row)]
        for row in re.findall(r"<tr>(.*?)</tr>", table)
        if "<td>" in row
    ]


def test_the_transfer_table_by_hand(html):
    """Residual Slush at 9 m: 7 and 6 predicted, 8 and 10 zero-shot, 11 and 11 adapted; True Slush has the mean 12."""
    row = next(row for row in rows(html) if row[0][:2] == ["Residual", "Slush"])
    assert row == [
        ["Residual", "Slush", "Ê", "n", "=", "2"],
        ["6.5", "±", "0.7"],
        ["9.0", "±", "1.4", "CoM", "8.5", "±", "1.4", "paper", "9.1"],
        ["75", "%", "paper", "67", "%"],
        ["11.0", "±", "0.0", "CoM", "11.0", "±", "0.0", "paper", "11.8"],
        ["92", "%", "paper", "87", "%"],
    ]


def test_the_finding_says_it_in_words(html):
    assert (
        "In 9 m of True Slush, zero-shot champions moved on average 12.0 m if they evolved in True Slush, "
        "−1.0 m (−8 %) if they evolved on Dry Land, 9.0 m (75 %) if they evolved in Residual Slush"
        in re.sub(r" (?=[,.])", "", Page(html).text)
    )


def test_a_diverged_champion_is_counted_out(study, drawn):
    trials = [*study.trials, TrialResult("residual_slush", 9.0, 2, 5.0, np.nan)]
    listed = rows(render_page(replace(study, trials=trials), drawn))
    row = next(row for row in listed if row[0][:2] == ["Residual", "Slush"])
    assert row[0][-1] == "3"
    assert " ".join(row[2]).startswith("9.0 ± 1.4 2 of 3 trials")


NASTY = "</script><script>alert(1)</script><img src=x onerror=alert(2)> & \"'` $title"


def test_every_text_of_the_study_is_escaped(study, drawn):
    nasty = replace(
        study,
        name=NASTY,
        title=NASTY,
        created_with={NASTY: NASTY},
        settings_yaml=NASTY,
        failed=[NASTY],
        not_possible=[NASTY],
        diverged=[NASTY],
        digests=[(NASTY, NASTY, "ab" * 32)],
        residual_errors=[replace(row, band=NASTY) for row in study.residual_errors],
        replays=[replace(study.replays[0], title=NASTY, seen_in=NASTY)],
    )
    title, draw = FIGURES["residual_error"]  # the figure with a text of the study
    page = Page(render_page(nasty, {**drawn, "residual_error": finish("residual_error", title, partial(draw, nasty))}))
    assert page.open == []
    assert set(page.scripts) == {"replays", "viewer"}
    assert "x" not in page.references
    assert json.loads(page.scripts["replays"])[0]["title"] == NASTY
    assert page.text.count("onerror=alert(2)") >= 8


def test_failed_work_items_are_listed(study, drawn, html):
    failed, untried, wild = "The study is incomplete", "need a failed work item", "Some designs diverged"
    for words in (failed, untried, wild, "work items failed"):
        assert words not in html
    lacking = Page(render_page(replace(study, failed=["dry_land 9 m trial 3"]), drawn)).text
    assert f"{failed}, and so is this page. These work items failed. dry_land 9 m" in lacking
    assert untried not in lacking and wild not in lacking


def test_work_items_that_were_not_tried_are_not_called_failed(study, drawn):
    untried = Page(render_page(replace(study, not_possible=["films/together not possible: …"]), drawn)).text
    assert (
        "These need a failed work item and were not tried. films/together" in untried and "items failed" not in untried
    )
    wild = Page(render_page(replace(study, diverged=["evolve: dry_land/9m/trial-3: 12 of 700"]), drawn)).text
    assert (
        "Some designs diverged. They count as unfit" in wild
        and "networks. evolve: dry_land/9m/trial-3: 12 of 700" in wild
    )
    assert "failed" not in wild and "incomplete" not in wild


@pytest.fixture
def started(study) -> StudyReport:
    """A study that has only begun."""
    return replace(study, trials=[], residual_errors=[], replays=[], digests=[], findings=Findings())


def test_a_study_that_has_only_begun_makes_a_page(started):
    page = Page(render_page(started))
    assert page.open == [] and page.scripts == {}
    for missing in ("The replay viewer", "Transfer at the greatest depth", "The transfer table"):
        assert f"{missing} : not available, because" in page.text


def test_how_it_was_made_is_there(html):
    text = Page(html).text
    assert "depths: [1, 9]" in text
    assert "ab" * 32 in text


def test_the_same_page_each_time_and_from_drawings_at_hand(study, started, drawn, html):
    assert render_page(study, drawn) == html
    assert render_page(started) == render_page(started, draw_all(started))


def test_the_contents_list_every_section(html):
    contents = re.search(r"<nav.*?</nav>", html)[0]
    assert re.findall(r'href="#(\w+)"', contents) == re.findall(r'<section id="(\w+)"', html)
    assert html.index("</nav>") < html.index("<section") and 'id="tank"' not in html


def test_the_first_screen_has_the_film_the_result_and_the_bars(html):
    first = html[html.index("<header") : html.index("</header>")]
    assert first.count('<p class="finding">') == 1
    assert re.findall(r'class="film" data-replay="(\d)"', first) == ["2", "5"]  # at 9 m, with residuals and without
    bars = re.findall(r"<dt>(.*?)</dt>.*?(−?[\d.]+) m(?: <small>paper (−?[\d.]+)</small>)?</span></dd>", first)
    assert bars == [
        ("True Slush", "12.0", "13.6"),
        ("Dry Land", "−1.0", "−0.8"),
        ("Residual Slush", "9.0", "9.1"),
        ("Single member", "3.0", ""),
    ]
    # From −1 to 13.6 m: 0 m is at 1 / 14.6 of the width, and 12 m take 12 / 14.6.
    assert 'class="true_slush" style="left: 6.8%; width: 82.2%"' in first


def test_what_a_study_does_not_have_is_left_out(study, html):
    """One depth and no networks: not a word on either, and no reasons."""
    trials = [trial for trial in study.trials if trial.depth == 9.0 and trial.environment in ("true_slush", "dry_land")]
    lean = replace(
        study,
        trials=trials,
        environments=("true_slush", "dry_land"),
        depths=(9.0,),
        trains_networks=False,
        residual_errors=[],
        findings=replace(
            study.findings, throws=None, accuracy=None, exploiters=(), phantom_thrust=(), member_errors=()
        ),
    )
    page = Page(render_page(lean))
    assert "not available" not in page.text
    assert not {"networks", "exploitation", "transfer_matrix", "data_set"} & set(page.ids)
    assert {"networks", "exploitation", "transfer_matrix", "data_set"} <= set(Page(html).ids)
    assert {"transfer_at_depth", "attribution", "contrasts", "paper"} <= set(page.ids)


def test_tables_can_be_downloaded(study):
    tables = {name: data.decode().splitlines() for name, data in tables_of(study).items()}
    assert set(tables) == {
        f"{name}.csv" for name in ("transfer", "paper", "contrasts", "exploiters", "luck", "lineage")
    }
    assert (
        tables["transfer.csv"][0]
        == "environment,depth,trial,predicted,zero_shot,zero_shot_com,adapted,adapted_com,predicted_sd,fitness"
    )
    assert tables["transfer.csv"][3] == "dry_land,9.0,0,60.0,-2.0,-2.5,4.0,4.0,,"
    assert tables["lineage.csv"][-1] == "21,4,4,crossover,9/5,4.0,12.0"
    assert len(tables["contrasts.csv"]) == len(study.findings.contrasts) + 1


def test_the_variance_between_replicates_stands_below_the_transfer_table(study, replicated, drawn, html):
    assert "variance" not in Page(html).ids and "variance.csv" not in tables_of(study)
    page = render_page(replace(study, findings=replicated), drawn)
    assert page.index('class="transfer"') < page.index('id="variance"') < page.index('<section id="paper"')
    rows = tables_of(replace(study, findings=replicated))["variance.csv"].decode().splitlines()
    assert len(rows) == 1 + len(replicated.replicated) == 3


def test_commands_of_the_page_are_commands(html, capsys, tmp_path):
    """Each runs as far as its store or its design file, which is not there."""
    commands = re.findall(r'data-command="(.*?)"', html)
    assert [command.split()[1] for command in commands] == ["simulate", "fabricate"]
    for command in commands:
        words = {"file": "none.json", "seen": "true_slush", "depth": "9", "store": str(tmp_path / "store")}
        assert call(*shlex.split(unescape(command).format(**words))[1:]) == 2
        said = capsys.readouterr().err
        assert "none.json: cannot be read" in said or "/store: expected a store" in said


def test_the_page_of_one_design_offers_what_it_has(slush_replay):
    """No other robot, no other environment, no colours of networks; and the design's origin is not known."""
    html = render_robot(replace(slush_replay, title="mine", environment=""), ["root +1.0 m"])
    page = Page(html)
    assert page.open == [] and not {"choice", "beside", "robot"} & set(page.ids)
    for words in ("Compare with", "other environment", "disagreement", "the study"):
        assert words not in page.text
    assert "where it evolved" not in page.text


def test_the_whole_grid_stays_under_twelve_megabytes(study, slush_replay, drawn):
    """10 depths × 3 environments × 10 trials of 1,000 generations; a replay of 20 s of each champion and exploiter.

    The best of an arm is seen in both environments, with overlays and the push of the slush.
    """
    rng = np.random.default_rng(0)
    trials = [
        TrialResult(environment, depth, number, 9.0, 8.0, 8.0, 8.0, 8.0, np.maximum.accumulate(rng.random(1000)))
        for depth in (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 9.0)
        for environment in ("true_slush", "dry_land", "residual_slush")
        for number in range(10)
    ]
    plain = replace(slush_replay, frames=np.resize(slush_replay.frames, (601, 6, 3)))
    doubt = Overlay("disagreement", "m/s²", np.zeros((601, 6)))
    best = replace(plain, push=np.zeros((601, 6, 2)), overlays=(doubt, replace(doubt, label="novelty")))
    replays = [best] * 52 + [plain] * 300
    grid = replace(study, trials=trials, replays=replays)
    of_trials = {name: FIGURES[name] for name in FIGURES if name.startswith(("transfer_a", "fitness_curves"))}
    assert len(of_trials) == 4
    figures = {name: finish(name, title, partial(draw, grid)) for name, (title, draw) in of_trials.items()}
    assert len(render_page(grid, {**drawn, **figures}).encode()) < 12_000_000
