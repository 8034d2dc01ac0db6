"""Champions of results files: their scores as samples, their shares of what *E* travels, and their names."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from tasks.analysis import paper
from tasks.analysis.estimates import Estimate, Sample, of_means, ratio, sample_of
from tasks.analysis.scores import ScoredTrial
from tasks.analysis.tables import ANALYSES
from tasks.residual import arm_kind

Results = Mapping[str, Any]

LEARNERS = ("law", "both", "wetted", "tried", "mass", "tried_mass", "drawn")  # of truths; tried: in two rounds
TWO_ROUNDS = 3  # evolutions: before, between and after them


def label_of(environment: str) -> str:
    """Name an arm and its symbol."""
    kind = arm_kind(environment)
    return f"{kind.label}, *{kind.symbol.replace('*', chr(92) + '*')}*"


def exploiters(studies: Iterable[Results], environment: str) -> str:
    """Count champions of an arm that travel less than half of their prediction."""
    champions = [row for study in studies for row in study["champions"] if row["environment"] == environment]
    return f"{sum(row['zero_shot'] < row['predicted'] / 2 for row in champions)} of {len(champions)}"


def champions_of(study: Results, environment: str, score: str, depth: float | None = paper.DEPTH) -> Sample:
    """Return the champions of an arm at a depth, or all; those of the same data set or draw belong together.

    A gain is what is travelled beyond the same bodies with motors off, where that was measured. There are none if a
    score of one of them was not.
    """
    rows = [
        row | {"gain": row["zero_shot"] - row.get("passive", 0.0)}
        for row in study["champions"]
        if row["environment"] == environment and depth in (row["depth"], None)
    ]
    learned = environment != study.get("fluid") and arm_kind(environment).learned
    redrawn = environment == "randomised_slush" and study.get("series") == "parameters"
    n_data_sets = study["n_replicates"] if learned or redrawn else 1
    if any(score not in row for row in rows):
        rows = []
    return sample_of(
        np.array([row[score] for row in rows]), np.array([row["trial"] % n_data_sets for row in rows], int)
    )


def compared_anew(study: Results, arm: str) -> list[dict[str, Any]]:
    """Compare a study's means and shares of an arm with the paper's anew, as its results file has them."""
    trials = [
        ScoredTrial(
            name, row["depth"], row["trial"], row["trial"] % n, zero_shot=row["zero_shot"], adapted=row["adapted"]
        )
        for row in study["champions"]
        for name in [row["environment"]]
        for n in [study["n_replicates"] if arm_kind(name).learned else 1]
    ]
    settings, rng = SimpleNamespace(data_sets=(), assessed_depth=paper.DEPTH), lambda *_: np.random.default_rng(0)
    as_recorded: Any = SimpleNamespace(trials=trials, settings=settings, rng=rng)
    rows: Any = ANALYSES["paper"].compute(as_recorded)
    written = (row.this_run.partition(" (") for row in rows)
    return [
        {"what": row.what, "paper": row.paper, "this_run": value, "interval": ends[:-1], "verdict": row.verdict}
        for row, (value, _, ends) in zip(rows, written, strict=True)
        if row.kind == "number" and arm in row.what
    ]


def share_of(part: Sample, whole: Sample) -> Estimate:
    """Estimate the ratio of the means of two groups of champions."""
    return ratio(part, whole, rng=np.random.default_rng(0))


def share_of_best(
    study: Results, environment: str, score: str, depth: float = paper.DEPTH, *, best_of: Results | None = None
) -> Estimate:
    """Estimate an arm's share of what *E*, that of its own study by default, travels zero-shot in the same steps."""
    of_best = "zero_shot" if score == "adapted" else score
    return share_of(
        champions_of(study, environment, score, depth), champions_of(best_of or study, "true_slush", of_best, depth)
    )


def studies_at(depth: float, *studies: Results, redrawn: Results) -> dict[str, Results]:
    """Return for each arm at a depth the study with the most data sets, or draws around the true slush."""
    around = [one for one in redrawn["studies"] if one["variant"].startswith("around")]
    having = {
        name: [one for one in (*around, *studies) if len(champions_of(one, name, "zero_shot", depth))]
        for name in ("dry_land", "residual_slush", "randomised_slush", "designed_throws")
    }
    return {name: max(those, key=lambda one: int(one["n_replicates"])) for name, those in having.items()}


def mean_share(sides: Mapping[float, Results], environment: str, best_of: Results) -> Sample:
    """Return the zero-shot share of *E* of each data set of an arm, averaged over depths, by the study of each."""
    by_data_set = []
    for depth, study in sides.items():
        best = champions_of(best_of, "true_slush", "zero_shot", depth).values.mean()
        by_data_set.append(shares_by_data_set(champions_of(study, environment, "zero_shot", depth), best))
    mean = np.mean(by_data_set, axis=0)
    return sample_of(mean, np.arange(len(mean)))


@dataclass(frozen=True)
class Kept:
    """What robots that evolved under a learner keep zero-shot."""

    of_best: Estimate  # of what *E* gains
    of_prediction: Estimate


@dataclass(frozen=True)
class Truth:
    """A world that robots are tried in, and what learners of 50 throws are worth there."""

    label: str
    best: float  # [m] what *E* gains
    learners: Mapping[str, Kept]


def truths(kicks: Results, curves: Results, rounds: Results | None = None) -> Iterator[Truth]:
    """Compare learners in every truth; some have an *E* of their own, of the same search."""
    of_curves = {study["fluid"]: study for study in curves["studies"]}
    for study in kicks["studies"]:
        fluid = study["fluid"]
        sides = {"law": (study, "law"), "both": (study, "slush_both"), "wetted": (study, "wetted")}
        if fluid in of_curves:
            sides = {name: (of_curves[fluid], f"{name}_50") for name in sides}
        sides |= {"mass": (study, "mass"), "drawn": (study, "randomised_slush")}
        for arm in rounds["arms"] if rounds else ():
            if arm["truth"] == fluid and arm["n_rounds"] == TWO_ROUNDS:
                name = "tried" if arm["form"] == "wetted" else "tried_mass"
                last = [row for row in arm["rounds"] if row["round"] == TWO_ROUNDS - 1]
                at = {"environment": name, "depth": study["depth"]}
                tried = [{**row, **at, "trial": row["seed"], "zero_shot": row["true"]} for row in last]
                sides[name] = {**study, "champions": [*study["champions"], *tried]}, name
        kept = {}
        for name, (side, evolved) in sides.items():
            gain, true, predicted, best = (
                champions_of(side, of, score, study["depth"])
                for of, score in ((evolved, "gain"), (evolved, "zero_shot"), (evolved, "predicted"), (fluid, "gain"))
            )
            if len(gain):
                pairs = np.stack((true.values, predicted.values), axis=1)  # of the same robots
                (of_prediction,) = of_means(lambda means: means[..., :1] / means[..., 1:], pairs, true.replicate)
                kept[name] = Kept(share_of(gain, best), of_prediction)
        yield Truth(study["label"], champions_of(study, fluid, "gain", study["depth"]).values.mean(), kept)


def with_conditions(study: Results, robust: Results) -> Results:
    """Add what each champion travels in other conditions, where it was measured; its displacement tells who it is."""
    measured = {(row["environment"], row["depth"], round(row["one"], 4)): row for row in robust["champions"]}
    champions = [
        {**measured.get((row["environment"], row["depth"], round(row["zero_shot"], 4)), {}), **row}
        for row in study["champions"]
    ]
    return {**study, "champions": champions}


def shares_by_data_set(sample: Sample, best: float) -> tuple[float, ...]:
    """Return the mean of each data set as a share of what the best travel."""
    return tuple(float(sample.values[sample.replicate == k].mean() / best) for k in np.unique(sample.replicate))
