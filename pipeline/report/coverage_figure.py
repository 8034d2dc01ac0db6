"""The figure of coverage: how much of what robots do lies outside the throws, by component of the state."""

from matplotlib.figure import Figure

from pipeline.report.data import StudyReport
from pipeline.report.drawing import FIGURE_WIDTH, NothingToDraw
from tasks.analysis.coverage import EVERYTHING
from tasks.residual import OBSERVATION
from tasks.world import ENVIRONMENTS

_LABELS = ("length", "height", "angle", "vx", "vy", "spin")
_SEEN_IN = {"dry_land": "random robots in the base simulator", "residual_slush": "robots evolved in the ensemble"}
_TITLES = {"throws": "the paper’s throws", "designed_throws": "throws designed for robots"}


def coverage(report: StudyReport) -> tuple[Figure, str]:
    """Draw a panel for each data set: a bar for each component and kind of robot."""
    found = report.findings.coverage
    if not found:
        raise NothingToDraw(report.findings.why("coverage", "no robots have been compared with the throws yet"))
    figure = Figure(figsize=(FIGURE_WIDTH, 1.9 * len(found) + 0.7))
    panels = figure.subplots(len(found), 1, sharex=True, squeeze=False).ravel()
    for panel, (words, by_robots) in zip(panels, found.items(), strict=True):
        for number, (seen_in, rows) in enumerate(by_robots.items()):
            shares = {row.component: 100 * row.share_outside for row in rows}
            y = [k + 0.2 * (2 * number - 1) for k in range(len(OBSERVATION))]
            whole = f"{_SEEN_IN[seen_in]}: {shares[EVERYTHING]:.0f} %"
            bars = [shares[name] for name in OBSERVATION]
            panel.barh(y, bars, height=0.36, color=ENVIRONMENTS[seen_in].color, label=whole)
        panel.set_yticks(range(len(OBSERVATION)), _LABELS)
        panel.invert_yaxis()
        panel.set_title(_TITLES.get(words, words))
        panel.legend(loc="best", fontsize=7)
    panels[-1].set_xlabel("share of the states outside the throws [%]")
    return figure, (
        "States of robots’ links before evolution that are outside the throws: farther from the nearest thrown state "
        "than robots’ states are from their mean. There the networks extrapolate, and their members may agree and be "
        "wrong. Each state is counted for the component that separates it most, so a long bar names a hole in the data."
    )
