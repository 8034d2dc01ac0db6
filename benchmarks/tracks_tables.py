"""Tables of docs/results/tracks-rollouts.json, which `python -m benchmarks.tracks` measures."""

import math
from collections.abc import Mapping, Sequence
from statistics import fmean, stdev
from typing import Any


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
    lines = ["| learned from | throws | displacement [m] | share of exact states |", "|---|--:|--:|--:|"]
    exact = {row["learned_from"]: row["displacement"] for row in results["studies"] if "rate" not in row}
    for row in results["studies"]:
        words, share = row["learned_from"], ""
        if words == "tracks":
            share = _share_of(row["displacement"], exact["exact states"])
            noise = _noise(row) if row["noise_mm"] else "no noise"
            words = f"tracks, {row['rate']:g} frames/s, {noise}"
        elif words == "video":
            share = _share_of(row["displacement"], exact["exact states of filmed throws"])
            words = f"synthetic video, {row['rate']:g} frames/s"
        elif words == "nothing":
            words = "nothing: evolved in True Slush"
        lines.append(f"| {words} | {row.get('n_throws', '')} | {_mean_of(row['displacement'])} | {share} |")
    return "\n".join(lines)


def fluids(results: Mapping[str, Any]) -> str:
    """Tabulate where champions get in fluids that the learner does not know."""
    lines = ["| fluid | evolved in | displacement [m] | share |", "|---|---|--:|--:|"]
    true = {row["fluid"]: row["displacement"] for row in results["fluids"] if row["learned_from"] == "nothing"}
    for row in results["fluids"]:
        is_true = row["learned_from"] == "nothing"
        share = "" if is_true else _share_of(row["displacement"], true[row["fluid"]])
        where = "the fluid" if is_true else "networks that learned from tracks of it"
        lines.append(f"| {row['fluid']} | {where} | {_mean_of(row['displacement'])} | {share} |")
    return "\n".join(lines)


def _noise(row: Mapping[str, Any]) -> str:
    return f"{row['noise_mm']:g} mm, {row['noise_deg']:g}°" if row["noise_mm"] else "none"


def _share_of(displacement: Sequence[float], of: Sequence[float]) -> str:
    """Write a ratio of means with its 95 % interval, by the delta method for its logarithm."""
    share = fmean(displacement) / fmean(of)
    deviation = math.hypot(*(stdev(group) / math.sqrt(len(group)) / fmean(group) for group in (displacement, of)))
    low, high = (share * math.exp(sign * 1.96 * deviation) for sign in (-1, 1))
    return f"{share:.0%} ({low:.0%} to {high:.0%})".replace("%", " %").replace("-", "−")


def _mean_of(displacement: Sequence[float]) -> str:
    return f"{fmean(displacement):z.1f} ± {stdev(displacement):.1f}".replace("-", "−")
