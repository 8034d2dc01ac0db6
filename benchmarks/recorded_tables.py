"""Tables of measurements that are not a study's: open choices, the virtual tank, intervals, the profile of kernels."""

from collections.abc import Mapping
from itertools import groupby
from typing import Any


def open_choices(results: Mapping[str, Any]) -> str:
    """Tabulate how far robots of True Slush get if a choice that the paper leaves open is made differently."""
    headings = ("decision", "instead", "root", "CoM", "n", "share of ours", "share of the paper's", "setting")
    lines = [f"| {' | '.join(headings)} |", "|---|---|--:|--:|--:|--:|--:|---|"]
    for group, rows in groupby(results["rows"], key=lambda row: row["group"]):
        lines += [f"| **{group}** |{' |' * 7}"] if group else []
        decided = ""
        for row in rows:
            shown, decided = "" if row["decided"] == decided else row["decided"], row["decided"]
            setting = f"`{row['setting']}`" if row["setting"] else ""
            shares = (f"{row[name]:.2f}" for name in ("share_of_ours", "share_of_papers"))
            displacement = (f"{row['mean']:.1f} ± {row['sd']:.1f}", f"{row['com']:.1f}", str(row["n"]))
            lines.append(f"| {' | '.join((shown, row['instead'] or '', *displacement, *shares, setting))} |")
    return "\n".join(lines)


def tank(results: Mapping[str, Any]) -> str:
    """Tabulate in how many trials robots cross the virtual tank and its dry floor."""
    lines = ["| in 150 s, by Froude's law | paper | the proposed robot | all 16 champions |", "|---|--:|--:|--:|"]
    for row in results["tank"]:
        cells = (_of(row[name]) for name in ("paper", "proposed", "all"))
        lines.append(f"| {' | '.join((row['test'], *cells))} |")
    return "\n".join(lines)


def torques(results: Mapping[str, Any]) -> str:
    """Tabulate how robots fare on the dry floor of the tank by the torque of their servos."""
    lines = [
        "| torque of the servo | in the simulation | crosses the dry floor | ends within 5 cm of its start |",
        "|--:|--:|--:|--:|",
    ]
    for row in results["torques"]:
        servo = f"{row['servo_kg_cm']:g} kg·cm" + (f" ({row['note']})" if "note" in row else "")
        cells = (servo, f"{row['simulation_n_m']} N·m", _of(row["crosses"]), _of(row["stays"]))
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _of(count: tuple[int, int]) -> str:
    return f"{count[0]} of {count[1]}"


def intervals_of_means(results: Mapping[str, Any]) -> str:
    """Tabulate how often intervals of displacements contain the truth, by the number of replicates."""
    lines = [
        "| replicates | the mean | Student's interval of it | difference from *E* | share of *E* "
        "| median width, in Student's |",
        "|--:" * 6 + "|",
    ]
    for row in results["means"]:
        rates = (_percent(row[name]) for name in ("mean", "students", "difference", "share"))
        lines.append(f"| {' | '.join((str(row['n_replicates']), *rates, str(row['width'])))} |")
    return "\n".join(lines)


def intervals_of_accuracy(results: Mapping[str, Any]) -> str:
    """Tabulate how often intervals of R and slope contain the truth, by the number of replicates."""
    lines = [
        "| replicates | R | trials resampled | median width, in theirs | slope | trials resampled | in theirs |",
        "|--:" * 7 + "|",
    ]
    for row in results["accuracy"]:
        cells = [str(row["n_replicates"])]
        for figure in ("r", "slope"):
            rates = (_percent(row[name]) for name in (figure, f"{figure}_of_trials"))
            cells += [*rates, str(row[f"{figure}_width"])]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def kernels(results: Mapping[str, Any]) -> str:
    """Tabulate what a generation takes, the shares of its parts, and how close to the peak the networks run."""
    parts = list(results["rows"][0]["shares"])
    headings = ("evolved in", "a generation", *parts, "the rest", "networks, of the fp32 peak")
    lines = [f"| {' | '.join(headings)} |", "|---" + "|--:" * (len(headings) - 1) + "|"]
    for row in results["rows"]:
        shares = [row["shares"][part] for part in parts]
        cells = [row["environment"], f"{1e3 * row['seconds']:.1f} ms", *map(_percent, (*shares, 1 - sum(shares)))]
        running = row["shares"]["networks"] * row["seconds"]
        cells.append(_percent(row["gflop"] / running / results["peak_gflops"]) if row["gflop"] else "")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _percent(share: float) -> str:
    return f"{share:.0%}".replace("%", " %")
