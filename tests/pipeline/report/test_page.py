"""The page: what it says, that it is whole and loads nothing, and that no text of a study is read as HTML."""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser

import numpy as np
import pytest
from command_line import call

from pipeline.config.settings import Settings
from pipeline.report.page import draw_all, render_page, render_robot, scale_words
from pipeline.report.render import tables_of
from pipeline.report.study_page import StudyPage
from pipeline.stages.cost import population_size
from tasks.residual import LEARNERS, arm_kind
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


def test_it_is_whole_and_nothing_is_fetched(html, study, drawn):
    """Links lead to places of the page, or to files beside it that the study writes."""
    page = Page(html)
    assert page.open == [] and len(set(page.ids)) == len(page.ids)
    outside = {reference for reference in page.references if not reference.startswith(("#", "data:"))}
    figures = {f"{name}.{kind}" for name in drawn for kind in ("svg", "png")}
    assert outside == {"replay.mp4", "replay.gif", *figures, *tables_of(study.tables)}
    assert not re.search(r'<(?!a)[^>]* href="[^#d]|url\((?!#)|@import|https?://', html)
    assert "default-src 'none'" in html
    targets = {reference[1:].partition(":")[0] for reference in page.references if reference.startswith("#")}
    assert targets <= set(page.ids) | {replay.robot for replay in study.replays}
    contents = re.search(r"<nav.*?</nav>", html)[0]
    assert re.findall(r'href="#(\w+)"', contents) == re.findall(r'<section id="(\w+)"', html)
    robot = '<a href="#robot-residual_slush-9m-trial-0">'  # of a table, which leads to the viewer that shows it
    assert robot in html and robot not in render_page(replace(study, replays=()), {})


def test_the_first_screen_has_the_result_and_the_best_arm_in_its_film(html, study):
    first = html[html.index("<header") : html.index("</header>")]
    assert first.count('<p class="finding">') == 1
    assert re.findall(r'class="film" data-replay="(\d)"', first) == ["2", "5"]  # at 9 m, with residuals and without
    assert re.search(r'<option value="(\d+)" selected>', html)[1] == "2"
    assert '<figure id="transfer_at_depth"' in first and 'aria-label="Displacement in True Slush' in first
    assert (
        "In 9 m of True Slush, zero-shot champions moved on average 12.0 m if they evolved in True Slush, "
        "−1.0 m (−8 %) if they evolved on Dry Land, 9.0 m (75 %) if they evolved in Residual Slush"
        in re.sub(r" (?=[,.])", "", Page(first).text)
    )


def test_the_scale_of_the_study_is_compared_with_the_papers(study):
    """The paper's evolution is 1,000 generations of 64 designs; other searches may name no population."""

    def changed(**changes) -> Settings:
        return study.settings.model_copy(update={"evolution": study.settings.evolution.model_copy(update=changes)})

    assert scale_words(changed(n_generations=1000)) == ""
    assert scale_words(changed(n_generations=100)) == "1/10 of the paper’s evolution: compare shares, not metres"
    assert scale_words(changed(n_generations=1)) == "1/1,000 of the paper’s evolution: the figures mean nothing"
    elsewhere = changed(n_generations=1, search="elsewhere", elsewhere={})
    assert (scale_words(elsewhere), population_size(elsewhere)) == ("", 1)


def cells(html: str, table: str) -> list[list[str]]:
    """The cells of each row of a table, without what is below them."""
    part = html[html.index(f'id="table-{table}"') :]
    rows = re.findall(r"<tr>(.*?)</tr>", part[: part.index("</table>")])
    found = [re.findall(r'data-column=".*?">(.*?)(?:<small>.*?)?</td>', row) for row in rows]
    return [[re.sub("<.*?>", "", cell) for cell in row] for row in found if row]


def test_the_transfer_table_is_of_the_greatest_depth_and_others_fold(html):
    """Residual Slush at 9 m: 8 and 10 zero-shot, 11 and 11 adapted; True Slush has the mean 12."""
    _best, _land, learned, _single = cells(html, "transfer")
    measured = ["9.0 ± 1.4", "75\u00a0%", "11.0 ± 0.0", "92\u00a0%", "6.5 ± 0.7"]
    assert learned == ["Residual Slush, Ê", *measured, "2", "9.1", "11.8"]
    assert "At 1 other depth" in html[html.index('id="table-transfer"') :]
    there = [name for name in (*ENVIRONMENTS, *list(LEARNERS)[:4]) if f"<dd>{arm_kind(name).about}" in unescape(html)]
    assert there == ["true_slush", "dry_land", "residual_slush", "single_member"]


NASTY = "</script><script>alert(1)</script><img src=x onerror=alert(2)> & \"'` $title {{ 7 * 7 }}"


def test_every_text_of_the_study_is_escaped(study, drawn):
    transfer = replace(study.rows("paper")[0], what=NASTY, verdict=NASTY)
    nasty = replace(
        study,
        settings=study.settings.model_copy(update={"name": NASTY}),
        tables={**study.tables, "paper": [transfer]},
        created_with={NASTY: NASTY},
        failed=[NASTY],
        not_possible=[NASTY],
        diverged=[NASTY],
        rejected={NASTY: 0.5},
        digests=[(NASTY, NASTY, "ab" * 32)],
        replays=[replace(study.replays[0], title=NASTY, seen_in=NASTY, group=NASTY)],
    )
    page = Page(render_page(nasty, drawn))
    assert page.open == []
    assert set(page.scripts) == {"replays", "viewer"}
    assert "x" not in page.references
    assert json.loads(page.scripts["replays"])[0]["title"] == NASTY
    assert page.text.count("onerror=alert(2)") >= 10 and "49" not in page.text.replace("{{ 7 * 7 }}", "")


def test_failed_and_untried_work_items_and_diverged_designs_are_listed(study, drawn, html):
    notices = ("The study is incomplete", "were not tried", "Some designs diverged")
    assert not any(words in html for words in notices)
    for kind, words in zip(("failed", "not_possible", "diverged"), notices, strict=True):
        text = Page(render_page(replace(study, **{kind: ["dry_land 9 m trial 3"]}), drawn)).text
        assert [notice for notice in notices if notice in text] == [words] and "dry_land 9 m trial 3" in text


def test_how_it_was_made_is_there_and_the_page_is_the_same_each_time(html, study, drawn):
    text = Page(html).text
    assert "depths: - 1.0 - 9.0" in text and "ab" * 32 in text and "puddle 0.1.0" in text
    assert render_page(study, drawn) == html


def test_what_a_study_does_not_have_is_left_out(study, html):
    """No networks: not a word on them, and no reasons. No t tests: none are counted."""
    networks, scored = {"networks", "trust", "watch", "data_set", "table-exploiters"}, {"table-transfer", "table-paper"}
    assert {*networks, *scored, "made"} <= set(Page(html).ids)
    for names, ids in (("scores", "transfer", "paper"), scored), ((), set()):
        tables = {**study.tables, "paper": [row for row in study.tables["paper"] if row.kind == "number"]}
        lean = StudyPage(study.settings, tables={name: tables[name] for name in names})
        page = Page(render_page(lean, draw_all(lean)))
        assert page.open == [] and page.scripts == {} and "t tests" not in page.text
        assert {"made", *ids} == set(page.ids) & {*networks, *scored, "made"}
    assert "This page fills up as the study progresses" in page.text


def test_tables_can_be_downloaded(study):
    tables = {name: data.decode().splitlines() for name, data in tables_of(study.tables).items()}
    assert set(tables) == {"columns.csv", *(f"{name}.csv" for name, rows in study.tables.items() if rows)}
    assert 'transfer,zero_shot,m,"Displacement of the root in the target, as it is."' in tables["columns.csv"]
    assert tables["scores.csv"][0].startswith("environment,depth,trial,")
    assert len(tables["paper.csv"]) == len(study.rows("paper")) + 1


def test_commands_of_the_page_are_commands(html, capsys, tmp_path):
    """Each runs as far as its store or its design file, which is not there."""
    commands = re.findall(r'data-command="(.*?)"', html)
    assert [command.split()[1] for command in commands] == ["simulate"]
    for command in commands:
        words = {"file": "none.json", "seen": "true_slush", "depth": "9", "store": str(tmp_path / "store")}
        assert call(*shlex.split(unescape(command).format(**words))[1:]) == 2
        said = capsys.readouterr().err
        assert "none.json: No such file" in said or "/store: expected a store" in said


def test_the_page_of_one_design_offers_what_it_has(slush_replay):
    """No other robot, no other environment, no colours of networks; and the design's origin is not known."""
    html = render_robot(replace(slush_replay, title="mine", environment=""), ["root +1.0 m"])
    page = Page(html)
    assert page.open == [] and not {"choice", "beside", "robot"} & set(page.ids)
    for words in ("Compare with", "other environment", "disagreement", "the study"):
        assert words not in page.text
    assert "where it evolved" not in page.text


def test_the_whole_grid_stays_under_twelve_megabytes(study, slush_replay, drawn):
    """A replay of 20 s of each of 300 champions; the best of 52 arms with disagreement."""
    plain = replace(slush_replay, frames=np.resize(slush_replay.frames, (601, 6, 3)))
    best = replace(plain, disagreement=np.zeros((601, 6)))
    grid = replace(study, replays=[best] * 52 + [plain] * 300)
    assert len(render_page(grid, drawn).encode()) < 12_000_000
