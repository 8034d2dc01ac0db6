"""Draw docs/curves.png from docs/results/curves.json: `.venv/bin/python docs/curves.py`."""

import json
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from samples import champions_of, share_of

DOCS = Path(__file__).resolve().parent
FORMS = {
    "law": ("the law of the paper's slush", "#1d2129", "s"),
    "both": ("this law, and networks", "#0072b2", "o"),
    "wetted": ("wetted networks", "#009e73", "^"),
    "symmetric": ("plain networks, with symmetric copies", "#e69f00", "v"),
    "plain": ("plain networks", "#d55e00", "D"),
}


def main() -> None:
    """Draw a panel for each fluid."""
    plt.style.use("pipeline.report.figures")
    studies = json.loads((DOCS / "results" / "curves.json").read_text())["studies"]
    figure, panels = plt.subplots(2, 3, figsize=(10, 6), sharex=True, sharey=True, layout="constrained")
    ticks: set[int] = set()
    for panel, study in zip(panels.flat, studies, strict=True):
        best = champions_of(study, study["fluid"], "gain", study["depth"])
        learned = {row["environment"] for row in study["champions"]} - {study["fluid"]}
        counts = sorted({int(name.rpartition("_")[2]) for name in learned})
        ticks |= {*counts}
        for number, (form, (label, colour, marker)) in enumerate(FORMS.items()):
            shares = [share_of(champions_of(study, f"{form}_{n}", "gain", study["depth"]), best) for n in counts]
            value = np.array([one.value for one in shares])
            low, high = np.array([one.interval or (np.nan, np.nan) for one in shares]).T
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


if __name__ == "__main__":
    main()
