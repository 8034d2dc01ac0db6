"""Tables of results in Markdown, as README.md and docs show them, from the contents of results files."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from benchmarks import cluster_tables, recorded_tables, table_cells, throws_tables, tracks_tables
from tasks.analysis import paper
from tasks.world import ENVIRONMENTS

_HEADINGS = ("zero-shot", "adapted", "share of *E*", "of *E* adapted")


def transfer(results: Mapping[str, Any], what: str) -> str:
    """Tabulate the champions of a study: at one depth, such as "9m", or at all of them, "all"."""
    depths = dict.fromkeys(arm["depth"] for arm in results["arms"])
    chosen = list(depths) if what == "all" else [float(what.removesuffix("m"))]
    with_paper, several = chosen == [paper.DEPTH], len(chosen) > 1
    predicted = _predicted_headings(results)
    headings = ["depth [m]"] * several + ["evolved in", *predicted, *_HEADINGS] + ["paper"] * with_paper
    left = 2 if several else 1
    lines = [f"| {' | '.join(headings)} |", f"|{'---|' * left}{'--:|' * (len(headings) - left)}"]
    for depth in chosen:
        arms = {arm["environment"]: arm for arm in results["arms"] if arm["depth"] == depth}
        for name in [name for name in ENVIRONMENTS if name in arms]:
            cells = [f"{depth:g}"] * several + _cells(name, arms, len(predicted)) + [_papers(name)] * with_paper
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def accuracy(results: Mapping[str, Any]) -> str:
    """Tabulate how well ensembles predict, beside the paper's figures."""
    ensembles = {kind.learns_from: kind.label for kind in ENVIRONMENTS.values() if kind.networks == "all"}
    several = len({row.get("learned_from") for row in results["accuracy"]}) > 1
    headings = ["ensemble"] * several + ["predicted by", "Pearson's R", "slope", "paper: R, slope"]
    left = 2 if several else 1
    lines = [f"| {' | '.join(headings)} |", f"|{'---|' * left}{'--:|' * (len(headings) - left)}"]
    for row in results["accuracy"]:
        name = _PREDICTORS.get(row["name"], row["name"])
        figures = (table_cells.figure(row[figure]) for figure in ("r", "slope"))
        cells = [ensembles.get(row.get("learned_from"), "")] * several + [name, *figures, _papers_figures(row["name"])]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def comparison(results: Mapping[str, Any]) -> str:
    """Tabulate the paper's numbers, other than t tests, beside a study's and their verdicts."""
    lines = ["| | paper | this study (95 %) | verdict |", "|---|--:|--:|---|"]
    for row in results["comparison"]:
        if not row["what"].startswith("Student") and row["this_run"] != "-":
            own = f"{row['this_run']} ({row['interval']})" if row["interval"] else row["this_run"]
            cells = (row["what"], row["paper"], own, row["verdict"])
            lines.append(f"| {' | '.join(_signed_words(cell) for cell in cells)} |")
    return "\n".join(lines)


def t_tests(results: Mapping[str, Any]) -> str:
    """Tabulate the paper's t tests with a study's differences, the intervals that judged them, and the verdicts."""
    lines = ["| Student's t test | paper | this study | interval | verdict |", "|---|---|---|---|---|"]
    for row in results["comparison"]:
        if row["what"].startswith("Student"):
            cells = (row["what"].partition(" t ")[2], row["paper"], row["this_run"], row["interval"], row["verdict"])
            lines.append(f"| {' | '.join(_signed_words(cell) for cell in cells)} |")
    return "\n".join(lines)


def _signed_words(text: str) -> str:
    """Write minus signs and percents in running text."""
    return re.sub(r"(?<!\S)(\(?)-(?=\d)", r"\1−", text).replace("%", " %")


def variance(results: Mapping[str, Any]) -> str:
    """Tabulate the deviation of each arm between replicates and within."""
    lines = [
        "| evolved in | depth [m] | quantity | n | replicates | SD between [m] | SD within [m] "
        "| variance between (95 %) |",
        "|---|--:|---|--:|--:|--:|--:|--:|",
    ]
    for row in results["variance"]:
        deviations = [f"{row[name]:.1f}" if row[name] is not None else "" for name in ("sd_between", "sd_within")]
        shares = [row[f"share_between{end}"] for end in ("", "_low", "_high")]
        share = "" if None in shares else f"{shares[0]:.0%} ({shares[1]:.0%} to {shares[2]:.0%})".replace("%", " %")
        words = row["quantity"].replace("_", "-")
        cells = [ENVIRONMENTS[row["environment"]].label, f"{row['depth']:g}", words, f"{row['n']}"]
        lines.append(f"| {' | '.join([*cells, str(row['n_replicates']), *deviations, share])} |")
    return "\n".join(lines)


def video(results: Mapping[str, Any]) -> str:
    """Tabulate what tracking makes of a synthetic camera's videos, by the speed of the bars."""
    headings = ("video, lens", "speed [m/s]", "frames", "lost", "position [mm]", "in a throw [mm]", "stated [mm]")
    headings += ("angle [°]", "stated [°]", "residual: vx, vy, ω")
    lines = [f"| {' | '.join(headings)} |", f"|---|---|{'--:|' * (len(headings) - 2)}"]
    for row in results["cases"]:
        low, high = row["band"]
        cells = [row["case"], f"{low:g} to {high:g}", str(row["frames"]), f"{row['lost']:.1%}".replace("%", " %")]
        cells += [f"{row[name]:.2f}" for name in ("position_mm", "jitter_mm", "stated_mm", "angle_deg", "stated_deg")]
        cells.append(" ".join(f"{share:.2f}" for share in row["residual"]))
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def digests(results: Mapping[str, Any]) -> str:
    """Tabulate the digests of a study's results."""
    rows = [f"| {name} | `{digest}` |" for name, digest in results["digests"].items()]
    return "\n".join(["| result | digest |", "|---|---|", *rows])


def made_with(results: Mapping[str, Any]) -> str:
    """Say with which code and on which processor results were measured, part by part if there are several."""
    if "parts" in results:
        return " ".join(f"{part}: {made_with(of)}" for part, of in results["parts"].items())
    made = results["made_with"]
    commit, dirty, _ = made["commit"].partition("-dirty")
    parts = [f"Measured at commit {commit[:7]}{' with changes' if dirty else ''}"]
    parts += [f"with the preset as it is at {made['preset at']}"] if "preset at" in made else []
    parts += [f"on {made['cpu']}"] if "cpu" in made else []
    parts += [f"{name} {made[key]}" for key, name in (("python", "Python"), ("torch", "torch")) if key in made]
    return f"{', '.join(parts)}."


def coverage(results: Mapping[str, Any]) -> str:
    """Tabulate what champions keep of their predictions, by how much of what they do lies outside the throws."""
    lines = [
        "| states outside the throws | champions | predicted | zero-shot | zero-shot / predicted |",
        "|--:|--:|--:|--:|--:|",
    ]
    for row in results["coverage"]:
        low, high = row["share_outside"]
        kept = row["zero_shot"] / row["predicted"]
        cells = [f"{low:.0%} to {high:.0%}", str(row["n"]), f"{row['predicted']:.1f}", f"{row['zero_shot']:.1f}"]
        lines.append(f"| {' | '.join([*cells, f'{kept:.0%}'])} |".replace("%", " %"))
    return "\n".join(lines)


def core_seconds(results: Mapping[str, Any]) -> str:
    """Tabulate the processor time of each stage, and its share."""
    of_stage = results["core_seconds"]
    total = sum(of_stage.values())
    lines = ["| stage | core-minutes | share |", "|---|--:|--:|"]
    lines += [f"| {stage} | {seconds / 60:.1f} | {seconds / total:.0%} |" for stage, seconds in of_stage.items()]
    return "\n".join([*lines, f"| all | {total / 60:.0f} | |"]).replace("%", " %")


TABLES = {
    "core-seconds": core_seconds,
    "residuals": tracks_tables.residuals,
    "studies": tracks_tables.studies,
    "fluids": tracks_tables.fluids,
    "robots": tracks_tables.robots,
    "accuracy": accuracy,
    "comparison": comparison,
    "t-tests": t_tests,
    "variance": variance,
    "coverage": coverage,
    "errors": throws_tables.errors,
    "inference": throws_tables.inference,
    "regularisation": throws_tables.regularisation,
    "video": video,
    "digests": digests,
    "made-with": made_with,
    "few": throws_tables.few_throws,
    "penalty": throws_tables.penalty,
    "rounds": throws_tables.rounds,
    "rules": throws_tables.rules,
    "members": throws_tables.members,
    "open-choices": recorded_tables.open_choices,
    "kernels": recorded_tables.kernels,
    "cluster-study": cluster_tables.study,
    "cluster-driver": cluster_tables.driver,
    "forecast-inputs": cluster_tables.forecast_inputs,
    "cluster-forecast": cluster_tables.forecast,
    "tank": recorded_tables.tank,
    "torques": recorded_tables.torques,
    "intervals-of-means": recorded_tables.intervals_of_means,
    "intervals-of-accuracy": recorded_tables.intervals_of_accuracy,
}
_PREDICTORS = {"mean": "mean μ over members", "mean - 1 sd": "μ − σ"}


def _papers_figures(name: str) -> str:
    figures = ("r", "slope")
    if name == "single members":
        return ", ".join(table_cells.figure(list(paper.RANGES[figure][:2])) for figure in figures)
    return ", ".join(table_cells.figure(paper.AGGREGATES[name, figure][0]) for figure in figures)


def _predicted_headings(results: Mapping[str, Any]) -> list[str]:
    """Return the headings of the prediction; results of the first version have μ alone, or μ - kσ."""
    if results["version"] == 1:
        return [f"predicted, {results.get('predicted_is', 'μ')}"]
    k = "" if results["penalty"] == 1 else f"{results['penalty']:g}"
    return ["predicted, μ", "σ", f"μ − {k}σ"]


def _cells(name: str, arms: Mapping[str, Any], n_predicted: int) -> list[str]:
    kind, arm = ENVIRONMENTS[name], arms[name]
    symbol = kind.symbol.replace("*", r"\*")
    cells = [f"{kind.label}, *{symbol}*", table_cells.mean(arm.get("predicted")) if name != "true_slush" else ""]
    if n_predicted > 1:
        of_members = ("predicted_sd", "fitness") if "predicted_sd" in arm else ()
        cells += [table_cells.signed(f"{arm[quantity]['mean']:z.1f}") for quantity in of_members] or ["", ""]
    cells += [table_cells.mean(arm.get(quantity)) for quantity in ("zero_shot", "adapted")]
    best = arms.get("true_slush", {})
    for reference in ("zero_shot", "adapted"):
        shares = [table_cells.share(arm.get(quantity), best.get(reference)) for quantity in ("zero_shot", "adapted")]
        cells.append("" if name == "true_slush" else ", ".join(share for share in shares if share))
    return cells


def _papers(name: str) -> str:
    """Return the paper's mean for True Slush, and its shares of it for other environments."""
    best = paper.MEANS[("true_slush", "zero_shot")][0]
    if name == "true_slush":
        return f"{best:g} m"
    shares = [_papers_share((name, quantity), best) for quantity in ("zero_shot", "adapted")]
    return ", ".join(table_cells.signed(f"{share:.0%}").replace("%", " %") for share in shares if share is not None)


def _papers_share(arm: Any, best: float) -> float | None:
    if arm in paper.RATIOS:
        return paper.RATIOS[arm][0]
    return paper.MEANS[arm][0] / best if arm in paper.MEANS else None
