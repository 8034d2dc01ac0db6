"""Write the tables of README.md and docs from results files: `python -m benchmarks.tables`.

A table stands between `<!-- table NAME of FILE -->` and `<!-- end -->`: NAME is a function below, FILE a results file.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from os.path import relpath
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
from scipy.stats import ttest_ind

from tasks.analysis import paper
from tasks.analysis.estimates import Sample, ratio, sample_of
from tasks.world import ENVIRONMENTS

ROOT = Path(__file__).resolve().parents[1]
SECTION = re.compile(r"<!-- table (\w+) of (\S+) -->\n.*?<!-- end -->", re.S)

Results = Mapping[str, Any]
Table = list[Sequence[object]]  # its first row are the headings


# -- studies: results.json of `puddle export` ------------------------------------------------------------------------


def shares(results: Results) -> Table:
    """Tabulate how far champions go at 9 m, and how much of *E* that is, with 95 % intervals."""
    table: Table = [("evolved in", "predicted", "zero-shot, share of *E*", "adapted, share of *E*", "paper")]
    for arm in results["arms"]:
        name = arm["environment"]
        if arm["depth"] == paper.DEPTH and name != "designed_single_member":
            predicted = "" if name == "true_slush" else f"{arm['predicted']['mean']:.1f} m"
            scores = [
                f"{arm[score]['mean']:z.1f} m" + ("" if name == "true_slush" else f", {_share(results, name, score)}")
                for score in ("zero_shot", "adapted")
            ]
            table.append((_label(name), predicted, *scores, _papers(name)))
    return table


def depths(results: Results) -> Table:
    """Tabulate how far *E* goes at each depth, and the share of it that other champions reach zero-shot."""
    arms = {(arm["environment"], arm["depth"]): arm["zero_shot"]["mean"] for arm in results["arms"]}
    names = ("dry_land", "residual_slush", "randomised_slush", "designed_throws")
    table: Table = [("depth [m]", "*E* [m]", *map(_label, names))]
    for depth in sorted({depth for _, depth in arms}):
        best = arms["true_slush", depth]
        table.append((f"{depth:g}", f"{best:.1f}", *(f"{arms[name, depth] / best:z.0%}" for name in names)))
    return table


def accuracy(results: Results) -> Table:
    """Tabulate how well ensembles predict designs from whole runs."""
    ensembles = {kind.learns_from: name for name, kind in ENVIRONMENTS.items() if kind.networks == "all"}
    table: Table = [("ensemble", "predicted by", "R", "slope", "paper: R", "slope")]
    for row in results["accuracy"]:
        papers = (f"{paper.AGGREGATES[row['name'], figure][0]:.2f}" for figure in ("r", "slope"))
        predictor = {"mean": "μ", "mean - 1 sd": "μ − σ"}[row["name"]]
        label = _label(ensembles[row["learned_from"]])
        table.append((label, predictor, f"{row['r']:.2f}", f"{row['slope']:.2f}", *papers))
    return table


def verdicts(results: Results) -> Table:
    """Compare the paper's numbers with a study's."""
    return [("", "paper", "this study (95 %)", "verdict")] + [
        (row["what"], row["paper"], f"{row['this_run']} ({row['interval']})", row["verdict"])
        for row in results["comparison"]
        if row["interval"] and not row["what"].startswith("Student")
    ]


def variants(results: Results) -> Table:
    """Tabulate how far champions go in studies that differ in one setting."""
    table: Table = [("", "evolved in", "predicted [m]", "zero-shot [m]", "share of *E*", "by data set", "exploiters")]
    for study in results["studies"]:
        for arm in (arm for arm in study["arms"] if arm["environment"] != "true_slush"):
            champions = [one for one in study["champions"] if one["environment"] == arm["environment"]]
            n_exploiters = sum(one["zero_shot"] < one["predicted"] / 2 for one in champions)
            best = fmean(one["zero_shot"] for one in study["champions"] if one["environment"] == "true_slush")
            of_data_set = [
                fmean(one["zero_shot"] for one in champions if one["trial"] % study["n_replicates"] == k) / best
                for k in range(study["n_replicates"])
            ]
            varied = study["variant"] if "throws" in study["series"] else f"{study['series']} {study['variant']}"
            predicted, true = (arm[quantity]["mean"] for quantity in ("predicted", "zero_shot"))
            row = [varied, _label(arm["environment"]), f"{predicted:z.1f}", f"{true:z.1f}", f"{true / best:z.0%}"]
            by_data_set = ", ".join(f"{share:z.0%}" for share in of_data_set)
            table.append([*row, by_data_set, f"{n_exploiters} of {len(champions)}"])
    return table


def tank(results: Results) -> Table:
    """Tabulate how robots to build fare in the virtual tank, beside the paper's robot in a real one."""
    return [("in 150 s, by Froude's law", "paper", "the proposed robot", "all 16 champions")] + [
        (row["test"], *(f"{row[whose][0]} of {row[whose][1]}" for whose in ("paper", "proposed", "all")))
        for row in results["tank"]
    ]


def core_minutes(results: Results) -> Table:
    """Tabulate the processor time of each stage."""
    of_stage = results["core_seconds"]
    total = sum(of_stage.values())
    rows = [(stage, f"{seconds / 60:.1f}", f"{seconds / total:.0%}") for stage, seconds in of_stage.items()]
    return [("stage", "core-minutes", "share"), *rows, ("all", f"{total / 60:.1f}", "")]


# -- what the paper leaves open --------------------------------------------------------------------------------------


def open_choices(results: Results) -> Table:
    """Tabulate how far *E* goes at the paper's scale of evolution if a choice is made differently."""
    return [("decided", "instead", "*E* [m]", "n", "setting")] + [
        (row["decided"], row["instead"] or "", f"{row['mean']:.1f} ± {row['sd']:.1f}", row["n"], _code(row["setting"]))
        for row in results["rows"]
    ]


def sensitivity(results: Results) -> Table:
    """Tabulate what each choice changes at a smaller scale of evolution, with Student's 95 % interval."""
    table: Table = [("decided", "instead", "difference [m]", "setting")]
    for row in results["rows"]:
        low, high = ttest_ind(row["displacement"], row["base"]).confidence_interval()
        difference = f"{fmean(row['displacement']) - fmean(row['base']):z.1f} ({low:.1f} to {high:.1f})"
        table.append((row["decided"], row["instead"], difference, _code(row["setting"])))
    return table


# -- make bench ------------------------------------------------------------------------------------------------------


def bench(results: Results) -> Table:
    """Compare what ran in the same rounds."""
    table: Table = [("ratio", "median", "spread", "at least")]
    for figure in (figure for figure in results["figures"] if figure["unit"] == "times"):
        spread = f"{min(figure['rounds']):.3g} to {max(figure['rounds']):.3g}"
        table.append((figure["name"], f"{figure['median']:.3g}", spread, figure["bound"] or ""))
    return table


TABLES: Mapping[str, Callable[[Results], Table]] = {
    of.__name__: of
    for of in (shares, depths, accuracy, verdicts, variants, tank, core_minutes, open_choices, sensitivity, bench)
}


# -- cells and pages -------------------------------------------------------------------------------------------------


def _label(environment: str) -> str:
    kind = ENVIRONMENTS[environment]
    return f"{kind.label}, *{kind.symbol.replace('*', chr(92) + '*')}*"


def _code(setting: str | None) -> str:
    return f"`{setting}`" if setting else ""


def _share(study: Results, environment: str, score: str) -> str:
    """Write an arm's share of *E* zero-shot, with its 95 % interval."""
    share = ratio(
        _sample(study, environment, score), _sample(study, "true_slush", "zero_shot"), rng=np.random.default_rng(0)
    )
    if share.low is None or share.high is None:
        return f"{share.value:z.0%}"
    return f"{share.value:z.0%} ({100 * share.low:z.0f} to {100 * share.high:z.0f})"


def _sample(study: Results, environment: str, score: str) -> Sample:
    """Return the champions of an arm at 9 m; those that learned from the same data set belong together."""
    rows = [one for one in study["champions"] if (one["environment"], one["depth"]) == (environment, paper.DEPTH)]
    n = study["n_replicates"] if ENVIRONMENTS[environment].networks != "none" else 1
    return sample_of(np.array([row[score] for row in rows]), np.array([row["trial"] % n for row in rows]))


def _papers(environment: str) -> str:
    """Write the paper's shares of its *E*, zero-shot and adapted."""
    best = paper.MEANS["true_slush", "zero_shot"][0]
    if environment == "true_slush":
        return f"{best:g} m"
    shares = [
        paper.RATIOS[arm][0] if arm in paper.RATIOS else paper.MEANS[arm][0] / best
        for arm in ((environment, "zero_shot"), (environment, "adapted"))
        if arm in paper.RATIOS or arm in paper.MEANS
    ]
    return ", ".join(f"{share:.0%}" for share in shares)


def markdown(table: Table) -> str:
    """Write a table in Markdown, columns of numbers to the right."""
    headings, *rows = [[_typographic(str(cell)) for cell in row] for row in table]
    number = [all(re.match(r"[−≤≥\d]|$", row[column]) for row in rows) for column in range(len(headings))]
    lines = [headings, ["--:" if right else "---" for right in number], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _typographic(cell: str) -> str:
    return re.sub(r"(?<![\w`])-(?=\d)", "−", cell.replace("%", " %").replace("  %", " %"))


def _section(found: re.Match[str], page: Path) -> str:
    """Return a table between its markers, and what it was measured with."""
    name, file = found.groups()
    results = json.loads((ROOT / file).read_text(encoding="utf-8"))
    made = results.get("made_with") or results.get("provenance") or results["machine"]
    link = f"[{Path(file).name}]({relpath(ROOT / file, page.parent)})"
    where = f"{link}, commit {made['commit'][:7]}, {made.get('cpu', 'AMD EPYC')}"
    return f"<!-- table {name} of {file} -->\n{markdown(TABLES[name](results))}\n\n*{where}*\n<!-- end -->"


def main() -> None:
    """Write the tables of all pages anew."""
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        write = partial(_section, page=page)
        page.write_text(SECTION.sub(write, page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
