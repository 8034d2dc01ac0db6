"""Write the tables of README.md and docs from results files: `.venv/bin/python docs/tables.py`.

A table stands between `<!-- table NAME of FILES -->` and `<!-- end -->`: NAME is a function below, FILES results files.
Most are made of results.json of `puddle export`, or list several of those as `studies`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import Field, make_dataclass
from os.path import relpath
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
from samples import (
    LEARNERS,
    TWO_ROUNDS,
    Results,
    champions_of,
    compared_anew,
    exploiters,
    label_of,
    mean_share,
    share_of,
    share_of_best,
    shares_by_data_set,
    studies_at,
    truths,
    with_conditions,
)
from scipy.stats import ttest_ind

from pipeline.report.render import as_markdown
from tasks.analysis import paper
from tasks.analysis.columns import column
from tasks.analysis.estimates import Estimate, Mean, Sample, sample_of, sum_of_means
from tasks.analysis.tables.transfer import papers_mean

ROOT = Path(__file__).resolve().parents[1]
SECTION = re.compile(r"<!-- table (\w+) of (.+?) -->\n.*?<!-- end -->", re.S)

MAKERS = (  # of the robots in the table of engines; robustness.json has others, too
    "True Slush",
    "Dry Land",
    "500 throws of the paper",
    "500 throws of the paper, the paper's networks",
    "3,400 designed throws",
    "domain randomisation",
)
ROBUST = ", robust"  # ends the name of those that evolved for robust_displacement

Tabulate = Callable[..., Iterable[tuple[Any, ...]]]
TABLES: dict[str, tuple[type, Tabulate]] = {}


def table(*columns: Field[Any]) -> Callable[[Tabulate], Tabulate]:
    """Register a function that yields rows of a table, a value for each column."""

    def register(tabulate: Tabulate) -> Tabulate:
        row = make_dataclass("Row", [(f"column_{i}", Any, column) for i, column in enumerate(columns)])
        TABLES[tabulate.__name__] = row, tabulate
        return tabulate

    return register


def text(label: str, form: str = "{}") -> Any:
    """Describe a column of words."""
    return column(label, form=form)


def metres(label: str) -> Any:
    """Describe a column of displacements."""
    return column(label, "m")


def share(label: str) -> Any:
    """Describe a column of shares, with their intervals if they are estimates."""
    return column(label, form="{:z.0%}")


def shares_by(label: str) -> Any:
    """Describe a column of several shares."""
    return column(label, form=lambda of: ", ".join(f"{one:z.0%}" for one in of))


# -- how far champions go --------------------------------------------------------------------------------------------


@table(
    text("evolved in"),
    metres("predicted"),
    metres("zero-shot"),
    share("of *E*"),
    share("of *E*, 1/240 s"),
    share("adapted, of *E*"),
)
def shares(study: Results, robust: Results) -> Iterable[tuple[Any, ...]]:
    """Tabulate how far champions go at 9 m, of *E* with usual and with shorter steps, but for *Ẽ* of one draw."""
    study = with_conditions(study, robust)
    for arm in study["arms"]:
        name, zero_shot = arm["environment"], arm["zero_shot"]["mean"]
        if name == "true_slush" and arm["depth"] == paper.DEPTH:
            yield label_of(name), None, zero_shot, None, None, share_of_best(study, name, "adapted")
        elif arm["depth"] == paper.DEPTH and name not in ("designed_single_member", "randomised_slush"):
            of = (share_of_best(study, name, score) for score in ("zero_shot", "quarter_steps", "adapted"))
            yield label_of(name), arm["predicted"]["mean"], zero_shot, *of


@table(
    text("robots evolved"),
    text("trials"),
    share("zero-shot"),
    share("1/240 s"),
    share("paper"),
    share("adapted"),
    share("paper"),
)
def front(large: Results, small: Results, redrawn: Results, robust: Results) -> Iterable[tuple[Any, ...]]:
    """Tabulate shares of the same *E*, that of the second study, at 9 m, beside the paper's numbers."""
    large, small, random = (with_conditions(study, robust) for study in (large, small, redrawn["studies"][0]))
    for evolved, study, name in (
        ("on dry land", small, "dry_land"),
        ("under large networks, from the paper’s throws", large, "residual_slush"),
        ("under small networks, from designed throws", small, "designed_throws"),
        ("in slushes drawn at random around the true one", random, "randomised_slush"),
    ):
        row: list[Any] = []
        for score in ("zero_shot", "adapted"):
            papers, whole = papers_mean(name, score, paper.DEPTH), papers_mean(*paper.BEST, paper.DEPTH)
            finer = [share_of_best(study, name, "quarter_steps", best_of=small)] if score == "zero_shot" else []
            row += [share_of_best(study, name, score, best_of=small), *finer, papers and whole and papers / whole]
        yield evolved, len(champions_of(study, name, "zero_shot").values), *row


@table(
    text("depth [m]"),
    metres("*E*"),
    share("Dry Land, *E′*"),
    share("Residual Slush, *Ê*"),
    share("Randomised Slush, *Ẽ*"),
    share("Designed throws, *Ê\\**"),
)
def depths(study: Results, learned: Results, row: Results, redrawn: Results) -> Iterable[tuple[Any, ...]]:
    """Tabulate the zero-shot shares of *E* at all depths, by the studies with the most data sets and draws of each.

    The last row is the mean over depths of what is learned, with Student's interval over data sets.
    """
    sides: dict[str, dict[float, Results]] = {}  # of each arm, by depth
    for depth in sorted({row["depth"] for row in study["champions"]}):
        for name, side in studies_at(depth, study, learned, row, redrawn=redrawn).items():
            sides.setdefault(name, {})[depth] = side
        shares = (share_of_best(by[depth], name, "zero_shot", depth, best_of=study) for name, by in sides.items())
        yield f"{depth:g}", fmean(champions_of(study, "true_slush", "zero_shot", depth).values), *shares
    means = {name: mean_share(sides[name], name, study) for name in ("residual_slush", "designed_throws")}
    yield "mean", None, *(sum_of_means(means[name]) if name in means else None for name in sides)


@table(
    text("depth [m]", "{:g}"),
    metres("*E*"),
    metres("16 starts"),
    metres("1/120 s"),
    metres("1/240 s"),
    metres("continuous"),
    share("*Ẽ* of *E*, 1/240 s"),
    share("*Ê\\** of *E*, 1/240 s"),
)
def robustness(
    robust: Results, study: Results, learned: Results, row: Results, redrawn: Results
) -> Iterable[tuple[Any, ...]]:
    """Tabulate what *E* travels in other conditions at all depths, and the shares of two arms with shorter steps."""
    columns = ("one", "starts", "half_steps", "quarter_steps", "continuous")
    best = with_conditions(study, robust)
    for depth in sorted({row["depth"] for row in study["champions"]}):
        found = studies_at(depth, study, learned, row, redrawn=redrawn)
        sides = {name: with_conditions(side, robust) for name, side in found.items()}
        shares = (
            share_of_best(sides[name], name, "quarter_steps", depth, best_of=best)
            for name in ("randomised_slush", "designed_throws")
        )
        yield depth, *(fmean(champions_of(best, "true_slush", of, depth).values) for of in columns), *shares


@table(
    text(""), text("paper"), text("8 of 4 × 256 (95 %)"), text("verdict"), text("4 of 2 × 48 (95 %)"), text("verdict")
)
def verdicts(*studies: Results) -> Iterable[tuple[Any, ...]]:
    """Compare the paper's numbers, other than t tests, with those of studies of large and of small networks.

    *E* is that of the last study, which has more trials of it.
    """
    best = [row for row in studies[-1]["champions"] if row["environment"] == "true_slush"]
    rows: dict[tuple[str, str], list[Any]] = {}
    for k, study in enumerate(studies):
        others = [row for row in study["champions"] if row["environment"] != "true_slush"]
        anew = {row["what"]: row for row in compared_anew({**study, "champions": [*best, *others]}, "True Slush")}
        for row in (anew.get(row["what"], row) for row in study["comparison"]):
            if row["interval"] and not row["what"].startswith("Student"):
                what = re.sub(",? at 9 m", "", row["what"])
                shown = rows.setdefault((what, row["paper"]), [None] * 2 * len(studies))
                shown[2 * k : 2 * k + 2] = f"{row['this_run']} ({row['interval']})", row["verdict"]
    return [(*of, *shown) for of, shown in rows.items()]


@table(
    text(""),
    text("evolved in"),
    metres("predicted"),
    metres("zero-shot"),
    share("of *E*"),
    shares_by("by data set"),
    text("exploiters"),
)
def variants(results: Results, whole: Results) -> Iterable[tuple[Any, ...]]:
    """Tabulate studies that differ in one setting; shares are of the same *E*, that of a study with more trials."""
    for study in results["studies"]:
        depth = study["arms"][0]["depth"]
        best = fmean(champions_of(whole, "true_slush", "zero_shot", depth).values)
        for arm in (arm for arm in study["arms"] if arm["environment"] != "true_slush"):
            name, (predicted, true) = arm["environment"], (arm[of]["mean"] for of in ("predicted", "zero_shot"))
            by_data_set = shares_by_data_set(champions_of(study, name, "zero_shot", None), best)
            varied = study["variant"] if "throws" in study["series"] else f"{study['series']} {study['variant']}"
            shown = share_of_best(study, name, "zero_shot", depth, best_of=whole)
            yield varied, label_of(name), predicted, true, shown, by_data_set, exploiters([study], name)


@table(
    text("throws"), share("9 m, of *E*"), share("adapted"), share("2 m, of *E*"), share("adapted"), text("exploiters")
)
def throws(results: Results, whole: Results) -> Iterable[tuple[Any, ...]]:
    """Tabulate studies of designed throws that differ in throws, networks and depth, by the *E* of a larger study."""
    name, studies = "designed_throws", {(one["form"], one["n_throws"], one["depth"]): one for one in results["studies"]}
    for form, n_throws in dict.fromkeys(key[:2] for key in studies):
        by_depth = {depth: study for (*what, depth), study in studies.items() if what == [form, n_throws]}
        of_best = [
            share_of_best(by_depth[depth], name, score, depth, best_of=whole) if depth in by_depth else None
            for depth in (9.0, 2.0)
            for score in ("zero_shot", "adapted")
        ]
        yield f"{n_throws}, {form}", *of_best, exploiters(by_depth.values(), name)


@table(text("throws"), share("law"), share("law and networks"), share("wetted"), share("plain, copies"), share("plain"))
def curves(results: Results) -> Iterable[tuple[Any, ...]]:
    """Tabulate shares of what *E* gains by the number of throws and the form of networks, at the paper's scale."""
    study = results["desk"]
    best = champions_of(study, study["fluid"], "gain")
    learned = {row["environment"] for row in study["champions"]} - {study["fluid"]}
    for number in sorted({int(name.rpartition("_")[2]) for name in learned}):
        names = (f"{form}_{number}" for form in ("law", "both", "wetted", "symmetric", "plain"))
        yield number, *(share_of(champions_of(study, name, "gain"), best) for name in names)


@table(
    text("truth"),
    metres("*E* gains"),
    share("slush's law"),
    share("this law and networks"),
    share("wetted"),
    share("wetted, two rounds"),
    share("added mass"),
    share("added mass, two rounds"),
    share("drawn slushes"),
)
def learners(kicks: Results, curves: Results, rounds: Results) -> Iterable[tuple[Any, ...]]:
    """Tabulate shares of what *E* gains in several truths, by what robots evolved in."""
    for truth in truths(kicks, curves, rounds):
        kept = (truth.learners.get(name) for name in LEARNERS)
        yield truth.label, truth.best, *(one and one.of_best for one in kept)


@table(text("robots evolved under"), share("the paper's slush"), share("MuJoCo's own fluid"), share("falling plates"))
def worlds(kicks: Results, curves: Results) -> Iterable[tuple[Any, ...]]:
    """Tabulate the same for the README: three truths, and four learners."""
    by_label = {truth.label: truth for truth in truths(kicks, curves)}
    shown = [by_label[label] for label in ("the paper's slush", "MuJoCo's own fluid", "falling plates")]
    for name, learner in (
        ("the law of the slush, fitted", "law"),
        ("slushes drawn at random", "drawn"),
        ("networks that know what is under water", "wetted"),
        ("networks of added mass, struck throws", "mass"),
    ):
        yield name, *(truth.learners[learner].of_best for truth in shown)


@table(
    text("depth [m]", "{:g}"),
    text("robots"),
    metres("*E*"),
    share("*Ê\\** of *E*"),
    share("dry land of *E*"),
    share("*E* at 1/240 s"),
    share("*E* in MuJoCo"),
    share("*E* in a current"),
)
def controllers(results: Results) -> Iterable[tuple[Any, ...]]:
    """Tabulate what other robots travel: shares of their *E*, and of what this keeps elsewhere of its own."""
    for study in results["studies"]:
        depth, best = study["depth"], champions_of(study, "true_slush", "zero_shot", study["depth"])
        shares = [share_of_best(study, arm, "zero_shot", depth) for arm in ("designed_throws", "dry_land")]
        elsewhere = (champions_of(study, "true_slush", of, depth) for of in ("quarter_steps", "mujoco", "current"))
        yield depth, study["robots"], best.values.mean(), *shares, *(share_of(kept, best) for kept in elsewhere)


@table(text("truth"), text("learns"), *(text(f"{'round ' * (not k)}{k}") for k in range(4)))
def rounds(results: Results) -> Iterable[tuple[Any, ...]]:
    """Tabulate what the best robots of each round are predicted to travel, and travel."""
    for arm in (arm for arm in results["arms"] if arm["n_rounds"] > TWO_ROUNDS):
        by_round: dict[int, list[Mapping[str, float]]] = {}
        for row in arm["rounds"]:
            by_round.setdefault(row["round"], []).append(row)
        means = ([fmean(row[of] for row in rows) for of in ("predicted", "true")] for rows in by_round.values())
        throws = {"robots": "designed throws", "struck": "struck throws"}[arm["throws"]]
        learns = f"`{arm['form']}`, {throws} " + ("and robots" if arm["tries"] else "alone")
        yield arm["truth"], learns, *(f"{predicted:.1f} → {true:.1f}" for predicted, true in means)


@table(text("evolved in"), metres("predicted"), metres("zero-shot"), metres("adapted"), text("zero-shot → adapted [m]"))
def in_the_fluid(study: Results) -> Iterable[tuple[Any, ...]]:
    """Tabulate how far the champions of each arm go."""
    for name in dict.fromkeys(row["environment"] for row in study["champions"]):
        rows = [row for row in study["champions"] if row["environment"] == name]
        scores = [[row[score] for row in rows] for score in ("predicted", "zero_shot", "adapted")]
        by_robot = (" → ".join(f"{x:.1f}" for x in robot if x is not None) for robot in zip(*scores[1:], strict=True))
        means = (fmean(of) if None not in of else None for of in scores)
        yield label_of(name), *means, ", ".join(by_robot)


@table(
    text("depth [m]", "{:g}"),
    text("robots of"),
    metres("1/60 s"),
    metres("late"),
    metres("1/240 s"),
    metres("MuJoCo"),
    share("of *E*, 1/240 s"),
    share("of *E*, MuJoCo"),
    text("alike"),
)
def engines(robust: Results) -> Iterable[tuple[Any, ...]]:
    """Tabulate champions in Box2D and in MuJoCo; those that go as far within 15 % in steps of 1/240 s are alike."""
    columns = ("one", "added_late", "quarter_steps", "mujoco")
    groups: dict[tuple[float, str], list[Mapping[str, float]]] = {}
    for row in robust["champions"]:
        if "mujoco" in row and row["made_by"].removesuffix(ROBUST) in MAKERS:
            groups.setdefault((row["depth"], row["made_by"]), []).append(row)

    def scores(depth: float, makers: str) -> dict[str, Sample]:
        rows = {name: np.array([row[name] for row in groups[depth, makers]]) for name in (*columns, "data_set")}
        return {name: sample_of(rows[name], rows["data_set"]) for name in columns}

    def order(group: tuple[float, str]) -> tuple[float, bool, int]:
        return -group[0], group[1].endswith(ROBUST), MAKERS.index(group[1].removesuffix(ROBUST))

    for depth, makers in sorted(groups, key=order):
        of, best = scores(depth, makers), scores(depth, f"True Slush{ROBUST if makers.endswith(ROBUST) else ''}")
        shares = (share_of(of[name], best[name]) for name in columns[2:])
        alike = np.count_nonzero(abs(of["mujoco"].values / of["quarter_steps"].values - 1) <= 0.15)
        yield depth, makers, *(of[name].values.mean() for name in columns), *shares, f"{alike} of {len(of['one'])}"


@table(
    text("learned from"),
    metres("predicted"),
    metres("true"),
    share("of those of exact states"),
    shares_by("by data set"),
)
def tank(results: Results) -> Iterable[tuple[Any, ...]]:
    """Tabulate studies of tracked throws; the first is that of exact states."""
    exact = None
    for study in results["studies"]:
        predicted, true = (
            champions_of(study, "residual_slush", score, study["depth"]) for score in ("predicted", "zero_shot")
        )
        of_exact = None if exact is None else share_of(true, exact)
        exact = exact or true
        by_data_set = shares_by_data_set(true, fmean(exact.values))
        yield study["learned_from"], fmean(predicted.values), fmean(true.values), of_exact, by_data_set


# -- what choices change ---------------------------------------------------------------------------------------------


@table(text("decided"), text("instead"), metres("*E*"), text("n"), text("setting", "`{}`"))
def open_choices(results: Results) -> Iterable[tuple[Any, ...]]:
    """Tabulate what choices change at the paper's scale of evolution."""
    for row in results["rows"]:
        yield row["decided"], row["instead"], Mean(row["mean"], row["sd"], row["n"]), row["n"], row["setting"]


@table(text("decided"), text("instead"), metres("difference (95 %)"), text("setting", "`{}`"))
def sensitivity(results: Results) -> Iterable[tuple[Any, ...]]:
    """Tabulate what choices change at a smaller scale of evolution, with Student's interval."""
    for row in results["rows"]:
        low, high = ttest_ind(row["displacement"], row["base"]).confidence_interval()
        difference = Estimate(fmean(row["displacement"]) - fmean(row["base"]), low, high)
        yield row["decided"], row["instead"], difference, row["setting"]


@table(text("decided"), text("instead"), metres("predicted"), metres("zero-shot"), share("of *E*"), text("exploiters"))
def learning(results: Results) -> Iterable[tuple[Any, ...]]:
    """Tabulate studies that differ in what the networks learn, or how."""
    name = "residual_slush"
    for study in results["studies"]:
        (arm,) = (arm for arm in study["arms"] if arm["environment"] == name)
        predicted, true = (arm[quantity]["mean"] for quantity in ("predicted", "zero_shot"))
        of_best = share_of_best(study, name, "zero_shot", study["depth"])
        yield study["decided"], study["instead"], predicted, true, of_best, exploiters([study], name)


# -- make bench ------------------------------------------------------------------------------------------------------


@table(text("ratio"), text("median", "{:.3g}"), text("spread"), text("at least", "{:g}"))
def bench(results: Results) -> Iterable[tuple[Any, ...]]:
    """Tabulate the ratios of what ran in the same rounds."""
    for figure in results["figures"]:
        if figure["unit"] == "times":
            spread = f"{min(figure['rounds']):.3g} to {max(figure['rounds']):.3g}"
            yield figure["name"], figure["median"], spread, figure["bound"]


# --------------------------------------------------------------------------------------------------------------------


def _section(marked: re.Match[str], page: Path) -> str:
    """Return a table between its markers, and what it was measured with."""
    name, files = marked.groups()
    studies = [json.loads((ROOT / file).read_text(encoding="utf-8")) for file in files.split()]
    row, tabulate = TABLES[name]
    cells = as_markdown(row, [row(*values) for values in tabulate(*studies)])
    where = "; ".join(_source(file, study, page) for file, study in zip(files.split(), studies, strict=True))
    return f"<!-- table {name} of {files} -->\n{cells}\n*{where}*\n<!-- end -->"


def _source(file: str, results: Results, page: Path) -> str:
    """Name a results file, and what made it."""
    made = results.get("made_with") or results.get("provenance") or results["machine"]
    commit, changed = made["commit"][:7], " with changes" if made["commit"].endswith("-dirty") else ""
    link = f"[{Path(file).name}]({relpath(ROOT / file, page.parent)})"
    cpu = made.get("cpu", "AMD EPYC").replace("(R)", "").removesuffix(" Processor")
    return f"{link}, commit {commit}{changed}, {cpu}"


def main() -> None:
    """Write the tables of all pages anew."""
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        written = SECTION.sub(lambda marked, page=page: _section(marked, page), page.read_text(encoding="utf-8"))
        page.write_text(written, encoding="utf-8")


if __name__ == "__main__":
    main()
