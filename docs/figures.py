"""Draw figures of docs from docs/results: `.venv/bin/python docs/figures.py`."""

import json
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from samples import LEARNERS, Results, champions_of, share_of, studies_at, truths

from tasks.analysis.estimates import sum_of_means

DOCS = Path(__file__).resolve().parent
FORMS = {
    "law": ("the law of the paper's slush", "#1d2129", "s"),
    "both": ("this law, and networks", "#0072b2", "o"),
    "wetted": ("wetted networks", "#009e73", "^"),
    "symmetric": ("plain networks, with symmetric copies", "#e69f00", "v"),
    "plain": ("plain networks", "#d55e00", "D"),
    "tried": ("wetted networks, two rounds", "#56b4e9", "<"),
    "mass": ("networks of added mass, struck throws", "#d55e00", "D"),
    "tried_mass": ("these, two rounds", "#e69f00", "v"),
    "drawn": ("drawn slushes", "#8b93a1", "X"),
}

ARMS = {
    "true_slush": ("True Slush, E", "#0072b2", "o"),
    "dry_land": ("Dry Land, E′", "#009e73", "s"),
    "residual_slush": ("Residual Slush, Ê", "#e69f00", "^"),
    "randomised_slush": ("Randomised Slush, Ẽ", "#8b93a1", "X"),
    "designed_throws": ("Designed throws, Ê*", "#d55e00", "v"),
}
SCORES = {"zero_shot": "zero-shot", "adapted": "controllers adapted"}


def results(name: str) -> Results:
    """Read a results file."""
    found: Results = json.loads((DOCS / "results" / f"{name}.json").read_text(encoding="utf-8"))
    return found


def curves() -> None:
    """Draw shares of what *E* gains by the number of throws, a panel for each fluid."""
    studies = results("curves")["studies"]
    figure, panels = plt.subplots(2, 3, figsize=(10, 6), sharex=True, sharey=True, layout="constrained")
    ticks: set[int] = set()
    for panel, study in zip(panels.flat, studies, strict=True):
        best = champions_of(study, study["fluid"], "gain", study["depth"])
        learned = {row["environment"] for row in study["champions"]} - {study["fluid"]}
        counts = sorted({int(name.rpartition("_")[2]) for name in learned})
        ticks |= {*counts}
        for number, form in enumerate(("law", "both", "wetted", "symmetric", "plain")):
            shares = [share_of(champions_of(study, f"{form}_{n}", "gain", study["depth"]), best) for n in counts]
            value = np.array([one.value for one in shares])
            low, high = np.array([one.interval or (np.nan, np.nan) for one in shares]).T
            label, colour, marker = FORMS[form]
            x = np.array(counts) * 1.06 ** (number - 2)
            ends = value - low, high - value
            panel.errorbar(x, value, ends, color=colour, marker=marker, label=label, elinewidth=0.7)
        panel.set_title(f"{study['label']}\nE gains {best.values.mean():.1f} m")
        panel.axhline(1, color="#c9ced6", zorder=0)
    panels[0, 0].set(xscale="log", ylim=(-0.3, 1.5), xticks=sorted(ticks), xticklabels=sorted(ticks))
    panels[0, 0].minorticks_off()
    panels[0, 0].yaxis.set_major_formatter(lambda share, _: f"{share:.0%}")
    figure.supxlabel("throws of 200 steps")
    figure.supylabel("share of what E gains, zero-shot")
    handles = panels[0, 0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside upper center", ncols=3)
    figure.savefig(DOCS / "curves.png", dpi=110, facecolor="white")


def learners() -> None:
    """Draw shares of what *E* gains, and of what is predicted, in every truth."""
    rows = list(truths(*map(results, ("kicks", "curves", "rounds"))))
    figure, panels = plt.subplots(1, 2, figsize=(10, 7), sharey=True, layout="constrained")
    for number, form in enumerate(LEARNERS):
        label, colour, marker = FORMS[form]
        for panel, of in zip(panels, ("of_best", "of_prediction"), strict=True):
            points = [(k, getattr(row.learners[form], of)) for k, row in enumerate(rows) if form in row.learners]
            value = np.array([share.value for _, share in points])
            low, high = np.array([share.interval or (np.nan, np.nan) for _, share in points]).T
            y = np.array([k for k, _ in points]) + 0.11 * (number - len(LEARNERS) // 2)
            ends = value - low, high - value
            panel.errorbar(value, y, xerr=ends, color=colour, marker=marker, label=label, elinewidth=0.7, ls="")
    for panel, title in zip(panels, ("of what E gains", "of what is predicted"), strict=True):
        panel.set(xlim=(-0.5, 1.7), title=title)
        panel.axvline(1, color="#c9ced6", zorder=0)
        panel.xaxis.set_major_formatter(lambda share, _: f"{share:.0%}")
    panels[0].set_yticks(range(len(rows)), [f"{row.label}\nE gains {row.best:.1f} m" for row in rows])
    panels[0].invert_yaxis()
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    figure.savefig(DOCS / "learners.png", dpi=110, facecolor="white")


def depths() -> None:
    """Draw how far robots travel in true slush by its depth, zero-shot and adapted."""
    study, learned, row, redrawn = map(results, ("desk", "desk-five", "desk-replicates", "randomised-slush"))
    deep = sorted({row["depth"] for row in study["champions"]})
    figure, panels = plt.subplots(1, 2, figsize=(10, 4.5), sharey=True, layout="constrained")
    for panel, (score, title) in zip(panels, SCORES.items(), strict=True):
        for number, (name, (label, colour, marker)) in enumerate(ARMS.items()):
            sides = [studies_at(depth, study, learned, row, redrawn=redrawn).get(name, study) for depth in deep]
            samples = [champions_of(side, name, score, depth) for side, depth in zip(sides, deep, strict=True)]
            means = [sum_of_means(one) for one in samples]
            value = np.array([mean.value for mean in means])
            low, high = np.array([mean.interval or (np.nan, np.nan) for mean in means]).T
            x = np.arange(len(deep)) + 0.1 * (number - len(ARMS) // 2)
            ends = value - low, high - value
            panel.errorbar(x, value, ends, color=colour, marker=marker, label=label, elinewidth=0.7)
        panel.axhline(0, color="#c9ced6", zorder=0)
        panel.set(title=title, ylim=(-15, 90))
        panel.set_xticks(range(len(deep)), [f"{depth:g}" for depth in deep])
    figure.supxlabel("depth [m]")
    figure.supylabel("displacement in true slush [m]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    figure.savefig(DOCS / "depths.png", dpi=110, facecolor="white")


if __name__ == "__main__":
    plt.style.use("pipeline.report.figures")
    depths()
    curves()
    learners()
