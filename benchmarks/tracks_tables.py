"""Tables of docs/results/tracks-rollouts.json, which `python -m benchmarks.tracks` measures."""

import math
from collections.abc import Mapping, Sequence
from statistics import fmean, stdev
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import t


def residuals(results: Mapping[str, Any]) -> str:
    """Tabulate the errors of residuals from tracks, by camera and speed of the bar."""
    bands = [band for band in results["residuals"][0]["error"] if band != "all"]
    headings = ["frames/s", "noise", *(f"{band.replace('-', ' to ')} m/s" for band in bands)]
    lines = [f"| {' | '.join(headings)} |", "|--:|---|" + "--:|" * len(bands)]
    for row in results["residuals"]:
        errors = (" ".join(f"{of:.2f}" for of in row["error"][band]) for band in bands)
        cells = [f"{row['rate']:g}", _noise(row), *errors]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def robots(results: Mapping[str, Any]) -> str:
    """Tabulate what networks get wrong along the paths of robots, by what they learned from."""
    lines = ["| learned from | `tracks.fit` | vx | vy | ω |", "|---|---|--:|--:|--:|"]
    for row in results["robots"]:
        words = row["learned_from"]
        if words == "tracks":
            words = f"tracks, {row['rate']:g} frames/s, {_noise(row) if row['noise_mm'] else 'no noise'}"
        lines.append(f"| {words} | {row.get('fit', '')} | {' | '.join(f'{of:.2f}' for of in row['error'])} |")
    return "\n".join(lines)


def studies(results: Mapping[str, Any]) -> str:
    """Tabulate where champions get, by what their networks learned from."""
    lines = ["| learned from | throws | trials | displacement [m] | share of exact states |", "|---|--:|--:|--:|--:|"]
    exact = {row["learned_from"]: row for row in results["studies"] if "rate" not in row}
    for row in results["studies"]:
        words, share = row["learned_from"], ""
        if words == "tracks":
            share = share_of(row, exact["exact states"]).words
            noise = _noise(row) if row["noise_mm"] else "no noise"
            words = f"tracks, {row['rate']:g} frames/s, {noise}"
        elif words == "video":
            share = share_of(row, exact["exact states of filmed throws"]).words
            words = f"synthetic video, {row['rate']:g} frames/s"
        elif words == "nothing":
            words = "nothing: evolved in True Slush"
        counts = f"{row.get('n_throws', '')} | {len(row['displacement'])}"
        lines.append(f"| {words} | {counts} | {_mean_of(row['displacement'])} | {share} |")
    return "\n".join(lines)


def fluids(results: Mapping[str, Any]) -> str:
    """Tabulate where champions get in fluids that the learner does not know."""
    lines = ["| fluid | evolved in | displacement [m] | share |", "|---|---|--:|--:|"]
    true = {row["fluid"]: row for row in results["fluids"] if row["learned_from"] == "nothing"}
    for row in results["fluids"]:
        is_true = row["learned_from"] == "nothing"
        share = "" if is_true else share_of(row, true[row["fluid"]]).words
        where = "the fluid" if is_true else "networks that learned from tracks of it"
        lines.append(f"| {row['fluid']} | {where} | {_mean_of(row['displacement'])} | {share} |")
    return "\n".join(lines)


def _noise(row: Mapping[str, Any]) -> str:
    return f"{row['noise_mm']:g} mm, {row['noise_deg']:g}°" if row["noise_mm"] else "none"


class Share(NamedTuple):
    """A ratio of mean displacements, and its 95 % interval."""

    value: float
    low: float
    high: float

    @property
    def words(self) -> str:
        """The ratio and its interval, for a table."""
        return f"{self.value:.0%} ({self.low:.0%} to {self.high:.0%})".replace("%", " %").replace("-", "−")


def share_of(row: Mapping[str, Any], of: Mapping[str, Any]) -> Share:
    """Return a ratio of mean displacements with its 95 % interval, by linearising the ratio.

    Trials of one data set share its throws and networks, so their mean counts as one value, which is paired with the
    mean of the same data set in the other row. Of one data set, trials of the same number are pairs.
    """
    n_data_sets = row.get("data_sets", 1)
    n_groups = n_data_sets if n_data_sets > 1 else len(row["displacement"])
    ours, theirs = (np.reshape(one["displacement"], (n_groups, -1)).mean(axis=1) for one in (row, of))
    share = float(ours.mean() / theirs.mean())
    deviation = np.std((ours - share * theirs) / theirs.mean(), ddof=1) / math.sqrt(n_groups)
    half = float(t.ppf(0.975, n_groups - 1) * deviation)
    return Share(share, share - half, share + half)


def _mean_of(displacement: Sequence[float]) -> str:
    return f"{fmean(displacement):z.1f} ± {stdev(displacement):.1f}".replace("-", "−")
