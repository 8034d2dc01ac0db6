from __future__ import annotations

import io
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from functools import partial

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import style as mpl_style
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

from pipeline.report.accuracy_figure import prediction_accuracy
from pipeline.report.data import TrialResult
from pipeline.report.drawing import _STYLE, PAPER_MARK, Drawing, Missing, finish
from pipeline.report.figures import FIGURES, draw_all
from pipeline.report.findings import Findings
from tasks.analysis.uncertainty import Estimate
from tasks.world import ENVIRONMENTS


def draw(name: str, study) -> Drawing | Missing:
    title, figure = FIGURES[name]
    return finish(name, title, partial(figure, study))


def texts(drawing: Drawing) -> list[str]:
    nodes = ElementTree.fromstring(drawing.svg).iter("{http://www.w3.org/2000/svg}text")
    return ["".join(node.itertext()) for node in nodes]


def test_every_figure_is_drawn_twice(drawn):
    assert list(drawn) == list(FIGURES)
    for drawing in drawn.values():
        assert isinstance(drawing, Drawing)
        assert ElementTree.fromstring(drawing.svg).tag == "{http://www.w3.org/2000/svg}svg"
        assert Image.open(io.BytesIO(drawing.png)).format == "PNG"
        assert drawing.description.endswith(".")


def test_the_same_bytes_each_time_whatever_style_is_set(study, drawn):
    with mpl.rc_context({"lines.linewidth": 9.0, "axes.facecolor": "red"}):
        again = draw_all(study)
    assert {name: (d.svg, d.png) for name, d in again.items()} == {name: (d.svg, d.png) for name, d in drawn.items()}
    assert not any(b"<dc:date>" in drawing.svg for drawing in drawn.values())


def test_the_arms_have_their_colours_and_names(study):
    others = [replace(study.trials[0], environment=name) for name in ENVIRONMENTS]
    drawing = draw("transfer_at_depth", replace(study, trials=[*study.trials, *others]))
    svg = drawing.svg.decode()
    for style in ENVIRONMENTS.values():
        assert style.color in svg
        assert set(style.label.split()) <= set(texts(drawing))
    assert ENVIRONMENTS["residual_slush"].adapted_color in svg


def test_the_paper_is_shown_at_nine_metres_only(study, drawn):
    assert PAPER_MARK in drawn["transfer_at_depth"].svg.decode()
    shallow = draw("transfer_at_depth", replace(study, trials=[t for t in study.trials if t.depth == 1.0]))
    assert PAPER_MARK not in shallow.svg.decode()
    assert "depth 1 m" in texts(shallow)


def test_a_panel_for_each_depth(drawn):
    for name in ("fitness_curves", "fitness_curves_wide"):
        assert {"depth 1 m", "depth 9 m"} <= set(texts(drawn[name]))


def test_only_velocities_in_the_residuals_error(drawn):
    labels = texts(drawn["residual_error"])
    assert {"vx [m/s]", "vy [m/s]", "omega [rad/s]", "< 0.5", "0.5–2"} <= set(labels)
    assert "x [m]" not in labels


def test_many_sizes_of_links_are_grouped(study):
    many = replace(study.findings.throws, length_scale=np.linspace(1.0, 3.0, 9))
    drawing = draw("data_set", replace(study, findings=replace(study.findings, throws=many)))
    assert {"1.0 to 1.7 m long, 3 throws", "2.3 to 3.0 m long, 3 throws"} <= set(texts(drawing))


def test_coverage_has_a_bar_for_each_component(drawn):
    labels = texts(drawn["coverage"])
    assert {"length", "height", "angle", "spin", "the paper’s throws", "throws designed for robots"} <= set(labels)
    assert any("robots evolved in the ensemble: 21 %" in label for label in labels)


def test_champions_are_points_by_coverage_and_excess(drawn):
    labels = texts(drawn["champion_coverage"])
    assert {"Residual Slush", "share of a champion’s states outside the throws [%]"} <= set(labels)


def test_intervals_of_two_replicates_do_not_hide_the_bars(study, drawn, replicated):
    gap, parts = Estimate(3.0, -30.0, 36.0), {"lost_to_body": Estimate(2.0), "lost_to_controller": Estimate(1.0)}
    row = replace(replicated.attributions[0], gap=gap, **parts)
    cut = draw("attribution", replace(study, findings=replace(replicated, attributions=[row])))
    assert {"−4", "0", "4"} <= set(texts(cut)) and not {"20", "−20"} & set(texts(cut))  # twice the gap, ± 6 m
    assert "go on beyond" in cut.description and "go on beyond" not in drawn["attribution"].description


def test_an_empty_study_says_why_for_each(study):
    empty = draw_all(replace(study, trials=[], residual_errors=[], findings=Findings()))
    assert {name: missing.reason for name, missing in empty.items() if isinstance(missing, Missing)} == {
        "attribution": "no champion’s controller has been adapted yet",
        "transfer_matrix": "no champion has been tested at another depth than its own yet",
        "data_set": "no link has been thrown yet, or the study needs no throws",
        "coverage": "no robots have been compared with the throws yet",
        "prediction_accuracy": "no design has been simulated under every member yet",
        "prediction_accuracy_wide": "no design has been simulated under every member yet",
        "aggregates": "no design has been simulated under every member yet",
        "member_error": "no member has been compared with True Slush yet",
        "champion_coverage": "no champion that evolved with networks has been compared with the throws yet",
        "phantom_thrust": "no member has been tested at low speed yet",
        "family_tree": "no champion’s ancestors have been traced yet",
        "transfer_at_depth": "no trial has finished yet",
        "transfer_across_depths": "no trial has finished yet",
        "fitness_curves": "no trial has finished a generation yet",
        "fitness_curves_wide": "no trial has finished a generation yet",
        "residual_error": "no member of the ensemble has been validated yet, or the study needs no networks",
    }


@pytest.mark.parametrize(
    "trials",
    [
        [TrialResult("residual_slush", 9.0, 0, 1.0, 1.0, curve=np.array([1.0]))],
        [TrialResult("residual_slush", 9.0, 0, -np.inf, np.nan, curve=np.full(5, -np.inf))],
        [TrialResult("dry_land", 0.0, n, 2.0, 2.0, 2.0, 2.0, 2.0, curve=np.full(5, 2.0)) for n in range(3)],
        [
            TrialResult("dry_land", 3.0, 0, 5.0, curve=np.arange(9.0)),
            TrialResult("dry_land", 3.0, 1, 5.0, curve=np.r_[-np.inf, np.arange(3.0)]),
            TrialResult("true_slush", 4.0, 0, 5.0, curve=np.empty(0)),
        ],
    ],
    ids=["one trial, one generation", "all diverged", "constant fitness", "half done, nothing scored"],
)
@pytest.mark.filterwarnings("error")
def test_partial_studies_draw_what_they_can_without_a_warning(study, trials):
    drawn = draw_all(replace(study, trials=trials, residual_errors=[], findings=Findings()))
    assert len(drawn) == len(FIGURES)
    assert isinstance(drawn["residual_error"], Missing)


def test_a_shorter_trial_cuts_the_mean_curve(study):
    """A mean must be over the same trials throughout: with 9 and 4 generations it ends after generation 3."""
    trials = [TrialResult("dry_land", 3.0, n, 5.0, curve=np.arange(float(length))) for n, length in ((0, 9), (1, 4))]
    drawing = draw("fitness_curves", replace(study, trials=trials))
    ticks = [text for text in texts(drawing) if text.isdigit()]
    assert "3" in ticks and "8" not in ticks


def test_r_and_slope_are_above_each_histogram(drawn, study):
    """For every member, and for μ and μ − σ above the ensemble's."""
    fits = {fit.name: fit for fit in study.findings.accuracy.regressions}
    for name in ("prediction_accuracy", "prediction_accuracy_wide"):
        shown = texts(drawn[name])
        for member in range(4):
            fit = fits[f"member {member}"]
            assert f"R {fit.r.value:.2f}, m {fit.slope.value:.2f}" in shown
        for symbol, fit in (("μ", fits["mean"]), ("μ − σ", fits["mean - 1 sd"])):
            assert f"{symbol}: R {fit.r.value:.2f}, m {fit.slope.value:.2f}" in shown
        assert "ensemble, designed throws" in shown


def test_every_aggregate_is_drawn(drawn, study):
    shown = texts(drawn["aggregates"])
    assert {"member 0", "μ", "μ − σ", "μ − 2 σ", "min", "median"} <= set(shown)
    assert len([text for text in shown if text.startswith("μ − ")]) == 7  # k of 0.25, 0.5, 0.75, 1, 1.5, 2 and 3


def test_cells_of_the_matrix_hold_the_means(drawn):
    assert {"30.0", "12.0", "18.0", "9.0"} <= set(texts(drawn["transfer_matrix"]))


def test_a_reason_of_the_analysis_replaces_the_figure(study):
    why = "a single member has no other to disagree with"
    missing = draw("phantom_thrust", replace(study, findings=Findings(missing={"phantom_thrust": why})))
    assert isinstance(missing, Missing) and missing.reason == why


def test_the_papers_values_have_a_colour_of_their_own(drawn):
    assert PAPER_MARK in drawn["aggregates"].svg.decode()


@pytest.mark.parametrize("n_members", [2, 4, 8])
@pytest.mark.parametrize("n_columns", [2, 5])
def test_labels_of_the_accuracy_figure_stay_clear_of_tick_labels(study, n_members, n_columns):
    accuracy = study.findings.accuracy
    last = accuracy.histograms
    names = (*(f"member {k}" for k in range(n_members)), "mean", "mean, designed_throws")
    shown = replace(
        last,
        names=names,
        counts=np.resize(last.counts, (len(names), *last.counts.shape[1:])),
        n_outside=np.zeros(len(names), int),
    )
    found = replace(study.findings, accuracy=replace(accuracy, histograms=shown))
    with mpl_style.context(["default", _STYLE]):
        figure, _ = prediction_accuracy(replace(study, findings=found), n_columns=n_columns)
        FigureCanvasAgg(figure).draw()
        labels = [figure._supxlabel, figure._supylabel]
        labels += [axes.xaxis.label for axes in figure.axes] + [axes.yaxis.label for axes in figure.axes]
        labels = [label.get_window_extent() for label in labels if label is not None and label.get_text()]
        ticks = [
            tick.label1.get_window_extent()
            for panel in figure.axes
            if panel.get_visible()
            for axis in (panel.xaxis, panel.yaxis)
            for tick in axis.get_major_ticks()
            if tick.label1.get_visible()
            and axis.get_view_interval()[0] <= tick.get_loc() <= axis.get_view_interval()[1]
        ]
    assert len(labels) == 2
    assert not any(label.overlaps(tick) for label in labels for tick in ticks)
