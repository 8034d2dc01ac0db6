"""Write the tables of README.md and docs from results files: `python -m benchmarks.tables`.

A table stands between `<!-- table NAME of FILES -->` and `<!-- end -->`: NAME is a function below, FILES results files.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from os.path import relpath
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
from scipy.stats import ttest_ind

from pipeline.report.render import as_markdown
from tasks.analysis import paper
from tasks.analysis.estimates import Estimate, Mean, Sample, ratio, sample_of
from tasks.analysis.registry import column
from tasks.analysis.tables.transfer import papers_mean
from tasks.world import environment_kind

ROOT = Path(__file__).resolve().parents[1]
SECTION = re.compile(r"<!-- table (\w+) of (.+?) -->\n.*?<!-- end -->", re.S)

Results = Mapping[str, Any]


# -- studies: results.json of `puddle export` ------------------------------------------------------------------------


@dataclass(frozen=True)
class Share:
    """How far the champions of an arm go, and how much of *E* that is."""

    evolved: str = column("evolved in", form="{}")
    predicted: float | None = column("predicted", "m")
    zero_shot: float = column("zero-shot", "m")
    of_best: Estimate | None = column("of *E*", form="{:z.0%}")
    adapted: Estimate | None = column("adapted, of *E*", form="{:z.0%}")


def shares(results: Results) -> Iterable[Share]:
    """Tabulate how far champions go at 9 m."""
    for arm in results["arms"]:
        name = arm["environment"]
        if name == "true_slush" and arm["depth"] == paper.DEPTH:
            yield Share(_label(name), None, arm["zero_shot"]["mean"], None, None)
        elif name != "designed_single_member" and arm["depth"] == paper.DEPTH:
            of = (_share(results, name, score) for score in ("zero_shot", "adapted"))
            yield Share(_label(name), arm["predicted"]["mean"], arm["zero_shot"]["mean"], *of)


@dataclass(frozen=True)
class Front:
    """How much of *E* the champions of an arm keep, beside the paper's number."""

    evolved: str = column("robots evolved", form="{}")
    n: int = column("trials", form="{}")
    zero_shot: Estimate = column("zero-shot", form="{:z.0%}")
    papers_zero_shot: float | None = column("paper", form="{:z.0%}")
    adapted: Estimate = column("adapted", form="{:z.0%}")
    papers_adapted: float | None = column("paper", form="{:z.0%}")


def front(large: Results, small: Results) -> Iterable[Front]:
    """Tabulate shares of the same *E*, that of the second study, at 9 m."""
    best = _sample(small, paper.BEST[0], "zero_shot", paper.DEPTH, 1)
    for evolved, study, name in (
        ("on dry land", small, "dry_land"),
        ("under large networks, from the paper’s throws", large, "residual_slush"),
        ("under small networks, from designed throws", small, "designed_throws"),
        ("in slushes drawn at random around the true one", small, "randomised_slush"),
    ):
        n_data_sets = study["n_replicates"] if environment_kind(name).learned else 1
        row: list[Any] = []
        for score in ("zero_shot", "adapted"):
            sample = _sample(study, name, score, paper.DEPTH, n_data_sets)
            papers, whole = papers_mean(name, score, paper.DEPTH), papers_mean(*paper.BEST, paper.DEPTH)
            row += [ratio(sample, best, rng=np.random.default_rng(0)), papers and whole and papers / whole]
        yield Front(evolved, len(sample.values), *row)


@dataclass(frozen=True)
class AtDepth:
    """How far *E* goes at a depth, and the share of it that other champions reach."""

    depth: float = column("depth", "m", form="{:g}")
    best: float = column("*E*", "m")
    dry_land: float = column("Dry Land, *E′*", form="{:z.0%}")
    residual_slush: float = column("Residual Slush, *Ê*", form="{:z.0%}")
    randomised_slush: float = column("Randomised Slush, *Ẽ*", form="{:z.0%}")
    designed_throws: float = column("Designed throws, *Ê\\**", form="{:z.0%}")


def depths(results: Results) -> Iterable[AtDepth]:
    """Tabulate the zero-shot shares of *E* at all depths."""
    arms = {(arm["environment"], arm["depth"]): arm["zero_shot"]["mean"] for arm in results["arms"]}
    for depth in sorted({depth for _, depth in arms}):
        best = arms["true_slush", depth]
        names = ("dry_land", "residual_slush", "randomised_slush", "designed_throws")
        yield AtDepth(depth, best, *(arms[name, depth] / best for name in names))


@dataclass(frozen=True)
class Beside:
    """A number of the paper beside those of two studies."""

    what: str = column("", form="{}")
    papers: str = column("paper", form="{}")
    large: str | None = column("8 of 4 × 256 (95 %)", form="{}")
    of_large: str | None = column("verdict", form="{}")
    small: str | None = column("4 of 2 × 48 (95 %)", form="{}")
    of_small: str | None = column("verdict", form="{}")


def verdicts(*studies: Results) -> Iterable[Beside]:
    """Compare the paper's numbers, other than t tests, with those of studies of large and of small networks."""
    rows: dict[tuple[str, str], list[Any]] = {}
    for k, study in enumerate(studies):
        for row in study["comparison"]:
            if row["interval"] and not row["what"].startswith("Student"):
                what = re.sub(",? at 9 m", "", row["what"])
                shown = rows.setdefault((what, row["paper"]), [None] * 2 * len(studies))
                shown[2 * k : 2 * k + 2] = f"{row['this_run']} ({row['interval']})", row["verdict"]
    return [Beside(*of, *shown) for of, shown in rows.items()]


@dataclass(frozen=True)
class Variant:
    """How far the champions of an arm go in a study that differs from others in one setting."""

    varied: str = column("", form="{}")
    evolved: str = column("evolved in", form="{}")
    predicted: float = column("predicted", "m")
    zero_shot: float = column("zero-shot", "m")
    of_best: float = column("of *E*", form="{:z.0%}")
    by_data_set: tuple[float, ...] = column("by data set", form=lambda of: ", ".join(f"{share:z.0%}" for share in of))
    exploiters: str = column("exploiters", form="{}")


def variants(results: Results) -> Iterable[Variant]:
    """Tabulate studies that differ in one setting."""
    for study in results["studies"]:
        best = fmean(one["zero_shot"] for one in study["champions"] if one["environment"] == "true_slush")
        for arm in (arm for arm in study["arms"] if arm["environment"] != "true_slush"):
            champions = [one for one in study["champions"] if one["environment"] == arm["environment"]]
            by_data_set = tuple(
                fmean(one["zero_shot"] for one in champions if one["trial"] % study["n_replicates"] == k) / best
                for k in range(study["n_replicates"])
            )
            varied = study["variant"] if "throws" in study["series"] else f"{study['series']} {study['variant']}"
            predicted, true = (arm[quantity]["mean"] for quantity in ("predicted", "zero_shot"))
            exploiters = _exploiters(study, arm["environment"])
            label = _label(arm["environment"])
            yield Variant(varied, label, predicted, true, true / best, by_data_set, exploiters)


@dataclass(frozen=True)
class ByThrows:
    """How far robots of designed throws go, by the number of throws and the form of the networks."""

    throws: str = column("throws", form="{}")
    at_9: Estimate | None = column("9 m, of *E*", form="{:z.0%}")
    adapted_at_9: Estimate | None = column("adapted", form="{:z.0%}")
    at_2: Estimate | None = column("2 m, of *E*", form="{:z.0%}")
    adapted_at_2: Estimate | None = column("adapted", form="{:z.0%}")
    exploiters: str = column("exploiters", form="{}")


def throws(results: Results) -> Iterable[ByThrows]:
    """Tabulate studies that differ in throws, networks and depth."""
    name = "designed_throws"
    studies = {(one["form"], one["n_throws"], one["depth"]): one for one in results["studies"]}
    for form, n_throws in dict.fromkeys(key[:2] for key in studies):
        own = {depth: study for (*what, depth), study in studies.items() if what == [form, n_throws]}
        shares = [
            _share(own[depth], name, score, depth) if depth in own else None
            for depth in (9.0, 2.0)
            for score in ("zero_shot", "adapted")
        ]
        champions = {"champions": [one for study in own.values() for one in study["champions"]]}
        yield ByThrows(f"{n_throws}, {form}", *shares, _exploiters(champions, name))


@dataclass(frozen=True)
class InFluid:
    """How far robots of a few throws go in another fluid, as a share of those that evolved in it."""

    fluid: str = column("fluid", form="{}")
    best: float = column("*E*", "m")
    of_25: Estimate = column("25 throws, of *E*", form="{:z.0%}")
    of_100: Estimate = column("100 throws, of *E*", form="{:z.0%}")


def fluids(results: Results) -> Iterable[InFluid]:
    """Tabulate studies whose target is another fluid."""
    for study in results["studies"]:
        best = _sample(study, study["fluid"], "zero_shot", study["depth"], 1)
        learned = (_sample(study, name, "zero_shot", study["depth"], study["n_replicates"]) for name in ("t25", "t100"))
        shares = (ratio(of, best, rng=np.random.default_rng(0)) for of in learned)
        yield InFluid(study["label"], fmean(best.values), *shares)


@dataclass(frozen=True)
class Tracked:
    """How far robots of tracked throws go, as a share of those of exact states."""

    learned_from: str = column("learned from", form="{}")
    predicted: float = column("predicted", "m")
    true: float = column("true", "m")
    of_exact: Estimate | None = column("of those of exact states", form="{:z.0%}")
    by_data_set: tuple[float, ...] = column("by data set", form=lambda of: ", ".join(f"{share:z.0%}" for share in of))


def tank(results: Results) -> Iterable[Tracked]:
    """Tabulate studies of tracked throws; the first is that of exact states."""
    samples = {
        score: [
            _sample(study, "residual_slush", score, study["depth"], study["n_replicates"])
            for study in results["studies"]
        ]
        for score in ("predicted", "zero_shot")
    }
    exact = samples["zero_shot"][0]
    for study, predicted, true in zip(results["studies"], samples["predicted"], samples["zero_shot"], strict=True):
        share = None if true is exact else ratio(true, exact, rng=np.random.default_rng(0))
        by_data_set = tuple(
            float(true.values[true.replicate == k].mean() / fmean(exact.values)) for k in np.unique(true.replicate)
        )
        yield Tracked(study["learned_from"], fmean(predicted.values), fmean(true.values), share, by_data_set)


@dataclass(frozen=True)
class Choice:
    """How far *E* goes if a choice is made differently."""

    decided: str = column("decided", form="{}")
    instead: str | None = column("instead", form="{}")
    best: Mean | None = column("*E*", "m")
    difference: Estimate | None = column("difference (95 %)", "m")
    n: int | None = column("n", form="{}")
    setting: str | None = column("setting", form="`{}`")


def open_choices(results: Results) -> Iterable[Choice]:
    """Tabulate what choices change at the paper's scale of evolution."""
    for row in results["rows"]:
        best = Mean(row["mean"], row["sd"], row["n"])
        yield Choice(row["decided"], row["instead"], best, None, row["n"], row["setting"])


def sensitivity(results: Results) -> Iterable[Choice]:
    """Tabulate what choices change at a smaller scale of evolution, with Student's interval."""
    for row in results["rows"]:
        low, high = ttest_ind(row["displacement"], row["base"]).confidence_interval()
        difference = Estimate(fmean(row["displacement"]) - fmean(row["base"]), low, high)
        yield Choice(row["decided"], row["instead"], None, difference, None, row["setting"])


@dataclass(frozen=True)
class Learned:
    """How far robots of the paper's throws go if networks learn differently."""

    decided: str = column("decided", form="{}")
    instead: str = column("instead", form="{}")
    predicted: float = column("predicted", "m")
    zero_shot: float = column("zero-shot", "m")
    of_best: Estimate = column("of *E*", form="{:z.0%}")
    exploiters: str = column("exploiters", form="{}")


def learning(results: Results) -> Iterable[Learned]:
    """Tabulate studies that differ in what the networks learn, or how."""
    name = "residual_slush"
    for study in results["studies"]:
        of_best = _share(study, name, "zero_shot", study["depth"])
        (arm,) = (arm for arm in study["arms"] if arm["environment"] == name)
        predicted, true = (arm[quantity]["mean"] for quantity in ("predicted", "zero_shot"))
        yield Learned(study["decided"], study["instead"], predicted, true, of_best, _exploiters(study, name))


# -- make bench ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Bench:
    """A ratio of what ran in the same rounds."""

    name: str = column("ratio", form="{}")
    median: float = column("median", form="{:.3g}")
    spread: tuple[float, ...] = column("spread", form=lambda rounds: f"{min(rounds):.3g} to {max(rounds):.3g}")
    bound: float | None = column("at least", form="{:g}")


def bench(results: Results) -> Iterable[Bench]:
    """Tabulate the ratios of a run."""
    for figure in results["figures"]:
        if figure["unit"] == "times":
            yield Bench(figure["name"], figure["median"], tuple(figure["rounds"]), figure["bound"])


TABLES: Mapping[str, tuple[type, Callable[..., Iterable[object]]]] = {
    "shares": (Share, shares),
    "front": (Front, front),
    "depths": (AtDepth, depths),
    "verdicts": (Beside, verdicts),
    "variants": (Variant, variants),
    "throws": (ByThrows, throws),
    "fluids": (InFluid, fluids),
    "tank": (Tracked, tank),
    "open_choices": (Choice, open_choices),
    "sensitivity": (Choice, sensitivity),
    "learning": (Learned, learning),
    "bench": (Bench, bench),
}


def _label(environment: str) -> str:
    kind = environment_kind(environment)
    return f"{kind.label}, *{kind.symbol.replace('*', chr(92) + '*')}*"


def _exploiters(study: Results, environment: str) -> str:
    """Count champions of an arm that travel less than half of their prediction."""
    own = [one for one in study["champions"] if one["environment"] == environment]
    return f"{sum(one['zero_shot'] < one['predicted'] / 2 for one in own)} of {len(own)}"


def _share(study: Results, environment: str, score: str, depth: float = paper.DEPTH) -> Estimate:
    """Estimate an arm's share of *E* zero-shot."""
    best = _sample(study, "true_slush", "zero_shot", depth, 1)
    n_data_sets = study["n_replicates"] if environment_kind(environment).learned else 1
    return ratio(_sample(study, environment, score, depth, n_data_sets), best, rng=np.random.default_rng(0))


def _sample(study: Results, environment: str, score: str, depth: float, n_data_sets: int) -> Sample:
    """Return the champions of an arm at a depth; those that learned from the same data set belong together."""
    rows = [one for one in study["champions"] if (one["environment"], one["depth"]) == (environment, depth)]
    return sample_of(np.array([row[score] for row in rows]), np.array([row["trial"] % n_data_sets for row in rows]))


def _section(found: re.Match[str], page: Path) -> str:
    """Return a table between its markers, and what it was measured with."""
    name, files = found.groups()
    studies = [json.loads((ROOT / file).read_text(encoding="utf-8")) for file in files.split()]
    kind, tabulate = TABLES[name]
    table = as_markdown(kind, list(tabulate(*studies)))
    where = "; ".join(_source(file, study, page) for file, study in zip(files.split(), studies, strict=True))
    return f"<!-- table {name} of {files} -->\n{table}\n*{where}*\n<!-- end -->"


def _source(file: str, results: Results, page: Path) -> str:
    """Name a results file, and what made it."""
    made = results.get("made_with") or results.get("provenance") or results["machine"]
    commit, changed = made["commit"][:7], " with changes" if made["commit"].endswith("-dirty") else ""
    link = f"[{Path(file).name}]({relpath(ROOT / file, page.parent)})"
    return f"{link}, commit {commit}{changed}, {made.get('cpu', 'AMD EPYC')}"


def main() -> None:
    """Write the tables of all pages anew."""
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        write = partial(_section, page=page)
        page.write_text(SECTION.sub(write, page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
