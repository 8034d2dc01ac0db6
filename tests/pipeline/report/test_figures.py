"""Figures: what they show, that partial studies draw what they can, and that their bytes are always the same."""

from __future__ import annotations

import io
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image

from pipeline.report.drawing import FIGURE_WIDTH, PAPER_MARK, Drawing
from pipeline.report.page import draw_all
from pipeline.report.palette import LOOKS
from pipeline.report.study_page import FIGURES, StudyPage, ThrowPaths
from tasks.analysis.scores import ScoredTrial
from tasks.analysis.tables.transfer import transfer_rows
from tasks.residual import arm_kind
from tasks.world import ENVIRONMENTS


def texts(drawing: Drawing) -> list[str]:
    nodes = ElementTree.fromstring(drawing.svg).iter("{http://www.w3.org/2000/svg}text")
    return ["".join(node.itertext()) for node in nodes]


def draw(name: str, study: StudyPage, monkeypatch) -> Drawing:
    monkeypatch.setattr("pipeline.report.page.FIGURES", {name: FIGURES[name]})
    return draw_all(study)[name]


def with_trials(study: StudyPage, trials: list[ScoredTrial]) -> StudyPage:
    depths = sorted({trial.depth for trial in trials})
    settings = study.settings.model_copy(update={"grid": study.settings.grid.model_copy(update={"depths": depths})})
    tables = {"scores": trials, "transfer": transfer_rows(trials, "true_slush", papers=True)}
    return replace(study, settings=settings, tables=tables)


def test_every_figure_is_drawn(drawn):
    assert set(drawn) == set(FIGURES) - {"elites"}  # of another search
    for drawing in drawn.values():
        assert ElementTree.fromstring(drawing.svg).tag == "{http://www.w3.org/2000/svg}svg"
        assert drawing.description.endswith(".")


def test_the_same_bytes_each_time_whatever_style_is_set(study, drawn):
    with mpl.rc_context({"lines.linewidth": 9.0, "axes.facecolor": "red"}):
        again = draw_all(study)
    assert again == drawn
    for kind in ("png", "pdf"):
        assert getattr(again["fitness_curves"], kind) == getattr(drawn["fitness_curves"], kind)


def test_figures_are_five_inches_wide(drawn):
    assert Image.open(io.BytesIO(drawn["fitness_curves"].png)).width == pytest.approx(300 * FIGURE_WIDTH, abs=1)


KNOWN = (*ENVIRONMENTS, "residual_slush", "single_member", "designed_throws", "designed_single_member")


def test_the_arms_have_their_colours_and_names_and_the_paper_is_at_nine_metres(study, monkeypatch):
    def arms(depth):
        grid = study.settings.grid.model_copy(update={"environments": KNOWN})
        whole = replace(study, settings=study.settings.model_copy(update={"grid": grid}))
        scores = {"zero_shot": 2.0, "adapted": 3.0, "status": "ok"}
        return with_trials(whole, [ScoredTrial(name, depth, 0, 0, **scores) for name in KNOWN])

    deep = draw("transfer_at_depth", arms(9.0), monkeypatch)
    for kind in map(arm_kind, KNOWN):
        assert LOOKS[kind.name].color in deep.svg.decode() and set(kind.label.split()) <= set(texts(deep))
    assert LOOKS["residual_slush"].adapted in deep.svg.decode()
    shallow = draw("transfer_at_depth", arms(1.0), monkeypatch)
    assert PAPER_MARK in deep.svg.decode() and PAPER_MARK not in shallow.svg.decode()


def test_a_study_that_has_only_begun_draws_nothing(study):
    assert draw_all(StudyPage(study.settings)) == {}
    assert "prediction_accuracy" not in draw_all(replace(study, tables={}))  # what is assessed is not analysed yet


@pytest.mark.parametrize(
    "trials",
    [
        [ScoredTrial("residual_slush", 9.0, 0, 0, zero_shot=1.0, status="ok")],
        [ScoredTrial("residual_slush", 9.0, 0, 0, predicted=-np.inf, zero_shot=np.nan, status="diverged")],
        [ScoredTrial("dry_land", 0.0, n, 0, zero_shot=2.0, adapted=2.0, status="ok") for n in range(3)],
        [ScoredTrial("dry_land", 3.0, 0, 0, predicted=5.0), ScoredTrial("true_slush", 4.0, 0, 0)],
    ],
    ids=["one trial", "diverged", "no spread", "nothing scored"],
)
@pytest.mark.filterwarnings("error")
def test_partial_studies_draw_what_they_can_without_a_warning(study, trials):
    curves = {("dry_land", 3.0): [np.arange(9.0), np.r_[-np.inf, np.arange(3.0)], np.empty(0), np.full(5, -np.inf)]}
    begun = StudyPage(study.settings, curves=curves)
    assert "fitness_curves" in draw_all(replace(with_trials(begun, trials), curves=curves))


def test_throws_of_many_sizes_share_panels(study, monkeypatch):
    """Thirds of 1 to 4 m, of which nothing was thrown in the middle one."""
    throws = ThrowPaths(np.array([1.0, 1.2, 1.4, 4.0]), np.cumsum(np.ones((4, 30, 3)), axis=1))
    shown = texts(draw("data_set", replace(study, throws=throws), monkeypatch))
    assert {"1.0 to 2.0 m long, 3 throws", "3.0 to 4.0 m long, 1 throws"} <= set(shown)


def test_a_shorter_trial_cuts_the_mean_curve(study, monkeypatch):
    """A mean must be over the same trials throughout: with 9 and 4 generations it ends after generation 3."""
    curves = {("dry_land", 3.0): [np.arange(9.0), np.arange(4.0)]}
    ticks = texts(draw("fitness_curves", replace(study, curves=curves), monkeypatch))
    assert "3" in ticks and "8" not in ticks


def test_r_and_slope_are_above_each_histogram(drawn, study):
    fits = {fit.name: fit for fit in study.rows("regressions") if fit.learned_from == "residual_slush"}
    shown = texts(drawn["prediction_accuracy"])
    for symbol, fit in (("μ", fits["mean"]), ("μ − σ", fits["mean - 1 sd"])):
        assert f"{symbol}: R {fit.r.value:.2f}, m {fit.slope.value:.2f}" in shown
    assert {"Residual Slush", "Designed throws"} <= set(shown)
