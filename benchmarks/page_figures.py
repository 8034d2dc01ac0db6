"""What results files say in the sentences of pages: figures, and whether claims in words hold.

A claim in words holds within tolerances: means of displacements count as equal within a tenth.
"""

import math
import re
from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any

import numpy as np
import scipy

from benchmarks.sentences import Recorded
from tasks.analysis import paper
from tasks.analysis.comparison import clustered, nested_difference
from tasks.analysis.replicates import NestedSample, nested_sample
from tasks.world import ENVIRONMENTS

EQUAL = 0.1  # relative difference of means that count as equal


def _moments(study: Recorded, environment: str, quantity: str, depth: float) -> Recorded:
    found: list[Recorded] = [of for of in study["arms"] if (of["environment"], of["depth"]) == (environment, depth)]
    if len(found) != 1 or quantity not in found[0]:
        raise ValueError(
            f"study {study['study']} has no {quantity} of {environment} at {depth:g} m, which a page quotes"
        )
    moments: Recorded = found[0][quantity]
    return moments


def mean(study: Recorded, environment: str, quantity: str, depth: float = paper.DEPTH) -> float:
    """Return the mean of an arm [m]."""
    found: float = _moments(study, environment, quantity, depth)["mean"]
    return found


def spread(study: Recorded, environment: str, quantity: str) -> str:
    """Return mean ± deviation of an arm at 9 m."""
    moments = _moments(study, environment, quantity, paper.DEPTH)
    return f"{moments['mean']:.1f} ± {moments['sd']:.1f}"


def share(study: Recorded, environment: str, quantity: str = "zero_shot", of: str = "zero_shot") -> float:
    """Return an arm's share of *E* at 9 m."""
    return mean(study, environment, quantity) / mean(study, "true_slush", of)


def kept(study: Recorded, environment: str, depth: float = paper.DEPTH, of: str = "predicted") -> float:
    """Return how much of its prediction an arm travels, or of another quantity."""
    return mean(study, environment, "zero_shot", depth) / mean(study, environment, of, depth)


def shortfall(study: Recorded, environment: str) -> float:
    """Return how far an arm stays behind its prediction at 9 m [m]."""
    return mean(study, environment, "predicted") - mean(study, environment, "zero_shot")


def percent(share: float) -> str:
    """Write a share in percent."""
    return f"{100 * share:z.0f}".replace("-", "−")


def _fit(study: Recorded, learned_from: str) -> Recorded:
    """Return R and slope of an ensemble's mean."""
    (row,) = (row for row in study["accuracy"] if (row["learned_from"], row["name"]) == (learned_from, "mean"))
    found: Recorded = row
    return found


# -- studies ---------------------------------------------------------------------------------------------------------


def _of_data_sets(study: Recorded, environment: str, n: int) -> list[list[Recorded]]:
    rows = [row for row in study["champions"] if (row["environment"], row["depth"]) == (environment, paper.DEPTH)]
    return [[row for row in rows if row["trial"] % n == k] for k in range(n)]


def _shares_of_data_sets(study: Recorded, environment: str, n: int) -> list[str]:
    best = mean(study, "true_slush", "zero_shot")
    of_each = _of_data_sets(study, environment, n)
    return [percent(fmean(row["zero_shot"] for row in rows) / best) for rows in of_each]


_KINDS_OF_THROWS = (("papers", "residual_slush"), ("designed", "designed_throws"))


def over_depths(desk: Recorded) -> Mapping[str, str]:
    """Return the ranges over depths of shares of *E*, zero-shot and adapted, and of the prediction."""
    shares = {f"{name}_{end}": of for name, arm in _KINDS_OF_THROWS for end, of in _ends(_shares(desk, arm)).items()}
    adapted = _ends(_shares(desk, "designed_throws", "adapted", "adapted"))
    travelled = _ends([kept(desk, "designed_throws", depth) for depth in _depths(desk)])
    return {
        **shares,
        **{f"adapted_{end}": of for end, of in adapted.items()},
        **{f"kept_{end}": of for end, of in travelled.items()},
        "deepest": f"{max(_beyond_chance(desk)):g}",
        "n_beyond": f"{len(_beyond_chance(desk))}",
        **{
            f"{name}_{place}": share
            for name, arm in _KINDS_OF_THROWS
            for place, share in zip(("first", "second"), _shares_of_data_sets(desk, arm, 2), strict=True)
        },
    }


_PONTOON_SCALE = 0.07  # metres of the bench per metre of simulation
_AIM = 0.97  # share of *E* that robots of designed throws were to retain


def aims(desk: Recorded) -> Mapping[str, str]:
    """Return at how many depths designed throws meet the aim, zero-shot and adapted, and where they miss it most."""
    found = {}
    for quantity in ("zero_shot", "adapted"):
        shares = dict(zip(_depths(desk), _shares(desk, "designed_throws", quantity, quantity), strict=True))
        worst = min(shares, key=shares.__getitem__)
        found |= {
            quantity: f"{sum(share >= _AIM for share in shares.values())}",
            f"{quantity}_where": f"{worst:g}",
            f"{quantity}_least": percent(shares[worst]),
        }
    return found


def aim_is_met_at_9m(desk: Recorded) -> bool:
    """Whether designed throws meet the aim at the paper's depth, zero-shot and adapted."""
    return all(
        _shares(desk, "designed_throws", quantity, quantity)[-1] >= _AIM for quantity in ("zero_shot", "adapted")
    )


def _shares(study: Recorded, environment: str, quantity: str = "zero_shot", of: str = "zero_shot") -> list[float]:
    depths = _depths(study)
    return [mean(study, environment, quantity, depth) / mean(study, "true_slush", of, depth) for depth in depths]


def _ends(shares: Sequence[float]) -> dict[str, str]:
    return {"low": percent(min(shares)), "high": percent(max(shares))}


def shares_of_five(replicates: Recorded) -> Mapping[str, str]:
    """Return the shares of *E* of the robots of each of five data sets, of the paper's and of designed throws."""
    return {
        f"{name}_{k}": share
        for name, environment in _KINDS_OF_THROWS
        for k, share in enumerate(_shares_of_data_sets(replicates, environment, 5))
    }


def _sample(study: Recorded, environment: str, depth: float = paper.DEPTH) -> NestedSample:
    rows = [row for row in study["champions"] if (row["environment"], row["depth"]) == (environment, depth)]
    learned = ENVIRONMENTS[environment].networks != "none"
    replicate = [row["trial"] % study["n_replicates"] if learned else 0 for row in rows]
    return nested_sample(np.array([row["zero_shot"] for row in rows]), np.array(replicate))


def differences(replicates: Recorded) -> Mapping[str, str]:
    """Return how much farther robots of designed throws travel, with intervals that include that between replicates."""
    found = {}
    for name, other in (("papers", "residual_slush"), ("best", "true_slush"), ("randomised", "randomised_slush")):
        gap = nested_difference(*(_sample(replicates, of) for of in ("designed_throws", other)), equal_variances=False)
        ends = (("", gap.value), ("_low", gap.low), ("_high", gap.high))
        found |= {f"{name}{end}": f"{metres:z.1f}".replace("-", "−") for end, metres in ends}
    return found


def robots_to_build(pontoon: Recorded) -> Mapping[str, str]:
    """Return where the champions of the robot to build get, how the proposed one fares in the tank, and its kit."""
    of_proposed = [row["proposed"][0] for row in pontoon["tank"]]
    metrics, counts = pontoon["kit"]["metrics"], pontoon["n_champions"]
    margins = [f"{value:.2f}" for name, value in sorted(metrics.items()) if name.startswith("margin.")]
    held = [champion for champion in pontoon["champions"] if not _exploits(champion)]
    (worst,) = (champion for champion in pontoon["champions"] if _exploits(champion))
    hours = sum(pontoon["core_seconds"].values()) / 3600
    outside = {row["trial"]: row["share_outside"] for row in pontoon["outside"]}
    return {
        **{
            name: f"{pontoon['arms'][0][quantity]['mean']:.0f} ± {pontoon['arms'][0][quantity]['sd']:.0f}"
            for name, quantity in (("predicted", "predicted"), ("true", "zero_shot"))
        },
        **dict(zip(("wet", "dry", "still"), map(str, of_proposed), strict=False)),
        "held": f"{len(held)}",
        "least": percent(min(champion["zero_shot"] / champion["predicted"] for champion in held)),
        "worst_predicted": f"{worst['predicted']:.0f}",
        "worst_true": f"{worst['zero_shot']:.1f}".replace("-", "−"),
        "sigma": f"{worst['predicted_sd']:.2f}",
        "sigma_least": f"{min(champion['predicted_sd'] for champion in held):.2f}",
        "sigma_most": f"{max(champion['predicted_sd'] for champion in held):.2f}",
        "servo": f"{pontoon['tank'][3]['all'][0]}",
        "warnings": f"{len(_warnings(pontoon))}",
        "limited_least": min(_warned(pontoon, _AT_LIMIT), key=float),
        "limited_most": max(_warned(pontoon, _AT_LIMIT), key=float),
        "draught": f"{float(_warned(pontoon, _DRAUGHT)[0]) / 10:.0f}",
        "fit": f"{counts['fit into the filled tank']}",
        "outside": percent(outside.pop(worst["trial"])),
        "outside_least": percent(min(outside.values())),
        "outside_most": percent(max(outside.values())),
        "crossing": f"{counts['cross the filled tank in every trial']}",
        "as_papers": f"{counts['and its dry floor in none']}",
        "height": f"{100 * _PONTOON_SCALE * pontoon['proposed']['wet_height']:.0f}",
        "faults": f"{metrics['n_faults']:.0f}",
        **dict(zip(("margin_1", "margin_2"), margins, strict=True)),
        "core_hours": f"{hours:.1f}",
        "hours": f"{hours / 2:.1f}",
    }


def _exploits(champion: Recorded) -> bool:
    """Whether a champion travels less than half of its prediction."""
    travels: float = champion["zero_shot"] / champion["predicted"]
    return travels < 1 / 2


def one_exploits(pontoon: Recorded) -> bool:
    """Whether one champion exploits its networks unnoticed, by σ and by coverage."""
    outside = {row["trial"]: row["share_outside"] for row in pontoon["outside"]}
    (worst,) = (champion["trial"] for champion in pontoon["champions"] if _exploits(champion))
    of_others = [share for trial, share in outside.items() if trial != worst]
    sigma = {champion["trial"]: champion["predicted_sd"] for champion in pontoon["champions"]}
    return min(of_others) < outside[worst] < max(of_others) and sigma[worst] == min(sigma.values())


_AT_LIMIT = re.compile(r"at its torque limit in (\d+)% of the run")
_DRAUGHT = re.compile(r"its draught is (\d+) mm")


def _warnings(pontoon: Recorded) -> list[str]:
    return [found["message"] for found in pontoon["kit"]["findings"] if found["severity"] == "warning"]


def _warned(pontoon: Recorded, pattern: re.Pattern[str]) -> list[str]:
    """Return the figures of the kit's warnings that fit a pattern."""
    return [figure for message in _warnings(pontoon) for figure in pattern.findall(message)]


def always_ahead(desk: Recorded) -> bool:
    """Whether robots of designed throws travel farther at every depth, in the mean."""
    arms = (_shares(desk, "designed_throws"), _shares(desk, "residual_slush"))
    return all(designed > papers for designed, papers in zip(*arms, strict=True))


def _beyond_chance(study: Recorded) -> list[float]:
    """Return the depths where robots of the two kinds of throws differ at 5 %, with the variance of data sets."""
    samples = {
        depth: [_sample(study, arm, depth) for arm in ("designed_throws", "residual_slush")] for depth in _depths(study)
    }
    p = {depth: clustered(*both).p for depth, both in samples.items()}
    return [depth for depth, of in p.items() if of is not None and of < 0.05]


def first_is_luckiest(replicates: Recorded) -> bool:
    """Whether robots of the paper's throws keep most with the first of five data sets."""
    of_each = [fmean(row["zero_shot"] for row in rows) for rows in _of_data_sets(replicates, "residual_slush", 5)]
    return max(of_each) == of_each[0]


def differences_hold(replicates: Recorded) -> bool:
    """Whether robots of designed throws are ahead of those of the paper's throws, and perhaps not of the others."""
    found = {name: float(metres.replace("−", "-")) for name, metres in differences(replicates).items()}
    return found["papers_low"] > 0 > max(found["best_low"], found["randomised_low"])


def ahead_of_all_but_the_best(replicates: Recorded) -> bool:
    """Whether robots of designed throws are ahead beyond chance of all others in slush, and not of *E* nor behind."""
    found = {name: float(metres.replace("−", "-")) for name, metres in differences(replicates).items()}
    return min(found["papers_low"], found["randomised_low"]) > 0 and found["best_low"] < 0 < found["best_high"]


def n_exploiters(study: Recorded, environment: str) -> int:
    """Return how many champions of an arm at 9 m travel less than half of their prediction."""
    arm = (environment, paper.DEPTH)
    return sum(_exploits(one) for one in study["champions"] if (one["environment"], one["depth"]) == arm)


def n_repeated(study: Recorded, other: Recorded) -> int:
    """Return how many of a study's champions have the same figures as those of the same trial of another."""
    found: list[set[tuple[Any, ...]]] = [
        {tuple(value for name, value in sorted(one.items()) if name != "digests") for one in of["champions"]}
        for of in (study, other)
    ]
    return len(found[0] & found[1])


def papers_order_holds(laptop: Recorded) -> bool:
    """Whether arms are in the paper's order in slush: Dry Land, the paper's throws, True Slush."""
    order = ("dry_land", "residual_slush", "true_slush")
    ordered = [[mean(laptop, name, "zero_shot", depth) for name in order] for depth in _depths(laptop) if depth > 0]
    return all(means == sorted(means) for means in ordered)


def ahead(laptop: Recorded) -> Mapping[str, str]:
    """Return at how many depths robots of designed throws are ahead of the paper's, and ahead beyond chance."""
    depths = _depths(laptop)
    designed, papers = (
        {depth: mean(laptop, name, "zero_shot", depth) for depth in depths}
        for name in ("designed_throws", "residual_slush")
    )
    return {
        "ahead": str(sum(designed[depth] > papers[depth] for depth in depths)),
        "beyond": str(sum(designed[depth] > papers[depth] for depth in _beyond_chance(laptop))),
        "depths": str(len(depths)),
    }


def _depths(study: Recorded) -> list[float]:
    return sorted({arm["depth"] for arm in study["arms"]})


def designed_throws_hold(laptop: Recorded) -> bool:
    """Whether robots of designed throws travel as far as predicted, and almost as far as those of True Slush."""
    fit, close = _fit(laptop, "designed_throws"), share(laptop, "designed_throws")
    predicts = fit["r"] > 0.9 and math.isclose(fit["slope"], 1, abs_tol=EQUAL)
    return predicts and close > 0.85 and abs(kept(laptop, "designed_throws") - 1) < EQUAL


def t_tests(laptop: Recorded) -> Mapping[str, str]:
    """Return how many of the paper's t tests have each outcome."""
    n = laptop["verdicts"]["t_tests"]
    counts = {"all": sum(n.values()), "same": n["agrees"], "other": n["differs"], "untold": n["cannot tell"]}
    return {name: f"{count}" for name, count in counts.items()}


def key_claim_is_undecided(laptop: Recorded) -> bool:
    """Whether all t tests can be judged, and that on zero-shot robots of Residual Slush at 9 m is undecided."""
    key = "Student's t at 9 m: Residual Slush zero-shot against Dry Land adapted"
    (verdict,) = (row["verdict"] for row in laptop["comparison"] if row["what"] == key)
    return bool(verdict == "cannot tell" and not laptop["verdicts"]["t_tests"]["not comparable"])


def magnitudes(laptop: Recorded, magnitudes: Recorded) -> Mapping[str, str]:
    """Return how much less far magnitudes take robots of the paper's throws, how much farther others, and Welch's p."""
    found = {}
    for name, arm, sign in (("less", "residual_slush", -1), ("farther", "designed_throws", 1)):
        of = [_moments(study, arm, "zero_shot", paper.DEPTH) for study in (magnitudes, laptop)]
        test = scipy.stats.ttest_ind_from_stats(
            *(one[key] for one in of for key in ("mean", "sd", "n")), equal_var=False
        )
        found |= {name: f"{sign * (of[0]['mean'] - of[1]['mean']):.1f}", f"p_{name}": f"{test.pvalue:.2f}"}
    return found


# -- why our E goes farther ------------------------------------------------------------------------------------------


def _choices(choices: Recorded, *wanted: str) -> list[Recorded]:
    return [row for row in choices["rows"] if row["setting"] and row["setting"].partition("=")[0] in wanted]


def _redrawn(choices: Recorded) -> Recorded:
    (row,) = (row for row in choices["rows"] if row["setting"] == "evolution.afpo.mutation.changed_genes=redraw")
    found: Recorded = row
    return found


def variation(choices: Recorded) -> Mapping[str, str]:
    """Return the range of *E* over ways to vary designs, and what resampled genes give the paper's ten trials."""
    means = [row["mean"] for row in choices["rows"] if row["group"] == "How designs vary"]
    row, (low, high) = _redrawn(choices), _repeated(choices)
    return {
        "low": f"{min(means):.0f}",
        "high": f"{max(means):.0f}",
        "redrawn": f"{row['mean']:.1f} ± {row['sd']:.1f}",
        "n": f"{row['n']}",
        "least": f"{low:.1f}",
        "most": f"{high:.1f}",
    }


def _repeated(choices: Recorded) -> tuple[float, float]:
    """Return the 95 % interval of the mean of the paper's ten trials, if they resampled genes as ours did."""
    row = _redrawn(choices)
    error = row["sd"] * math.sqrt(1 / row["n"] + 1 / paper.N_TRIALS)
    half = float(scipy.stats.t.ppf(0.975, row["n"] - 1)) * error
    return row["mean"] - half, row["mean"] + half


def variation_holds(choices: Recorded) -> bool:
    """Whether resampled genes get less far than ours, and as far as the paper's trials."""
    ours, row, (low, high) = choices["rows"][0], _redrawn(choices), _repeated(choices)
    moments = [of[name] for of in (ours, row) for name in ("mean", "sd", "n")]
    p = float(scipy.stats.ttest_ind_from_stats(*moments, equal_var=False).pvalue)
    return p < 0.001 and row["mean"] < ours["mean"] and low < paper.MEANS["true_slush", "zero_shot"][0] < high


def small_effects(choices: Recorded) -> Mapping[str, str]:
    """Return the largest effect of the choices that do not matter, and the gap to the paper [m]."""
    ours, papers = choices["rows"][0]["mean"], paper.MEANS["true_slush", "zero_shot"][0]
    small = _choices(choices, "slush.drag", "slush.drag_integration", "physics.spawn")
    small += [row for row in choices["rows"] if row["setting"] == "physics.motor_gain=3"]
    return {"most": f"{max(abs(row['mean'] - ours) for row in small):.0f}", "gap": f"{ours - papers:.1f}"}


def reach(choices: Recorded) -> Mapping[str, str]:
    """Return how far the whole robot gets where its root alone travels [m]."""
    reaching = _choices(choices, "physics.range_of_motion", "physics.motor_gain")
    com = sorted(row["com"] for row in reaching if row["setting"] != "physics.motor_gain=3")
    return {"low": f"{com[0]:.1f}", "high": f"{com[-1]:.1f}"}


def sensitivity_holds(sensitivity: Recorded) -> bool:
    """Whether intervals of the differences, in means of the base, are as the sentence says of its four variants."""
    found = {row["name"]: row for row in sensitivity["rows"]}
    within = [_interval(found[name]) for name in ("joint-limits", "motors-after-settling")]
    beyond = [_interval(found[name]) for name in ("peak-to-peak", "tournaments")]
    bound = paper.NEGLIGIBLE
    return all(-bound < low and high < bound for low, high in within) and all(
        high < -bound or low > bound for low, high in beyond
    )


def spans_the_bound(sensitivity: Recorded, variant: str) -> bool:
    """Whether the interval of a variant's difference, in means of the base, contains a bound of what is negligible."""
    (row,) = (row for row in sensitivity["rows"] if row["name"] == variant)
    low, high = _interval(row)
    return any(low < bound < high for bound in (-paper.NEGLIGIBLE, paper.NEGLIGIBLE))


def mutation_at_two_scales(sensitivity: Recorded, choices: Recorded) -> Mapping[str, str]:
    """Return what resampled genes and steps of 0.5 change at two scales of evolution [m]."""
    there = {row["name"]: fmean(row["displacement"]) - fmean(row["base"]) for row in sensitivity["rows"]}
    ours = choices["rows"][0]["mean"]
    (longer,) = (row for row in choices["rows"] if row["setting"] == "evolution.afpo.mutation.step=0.5")
    found = {
        "redrawn_there": -there["redraw"],
        "redrawn_here": ours - _redrawn(choices)["mean"],
        "longer_there": there["longer-steps"],
        "longer_here": ours - longer["mean"],
    }
    return {name: f"{metres:.1f}" for name, metres in found.items()}


def _interval(row: Recorded) -> tuple[float, float]:
    base, variant = row["base"], row["displacement"]
    found = scipy.stats.ttest_ind(variant, base).confidence_interval()
    return found.low / fmean(base), found.high / fmean(base)
