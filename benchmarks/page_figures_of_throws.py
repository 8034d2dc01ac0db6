"""What measurements of throws, tracks, videos and speed say in sentences of pages; page_figures.py has the studies."""

import math
from collections.abc import Mapping
from functools import partial
from statistics import fmean

import scipy

from benchmarks.page_figures import EQUAL, n_exploiters, percent, share, shortfall
from benchmarks.sentences import Recorded
from benchmarks.tracks_tables import Share, share_of
from tasks.analysis import paper


def _error(throws: Recorded, of: str, size: tuple[int, int], network: str = "2 × 32", inputs: int = 6) -> float:
    """Return the mean error of networks over depths and components."""
    wanted = (of, *size, network, inputs)
    (error,) = (
        row["error"]
        for row in throws["errors"]
        if (row["throws"], row["n_throws"], row["n_steps"], row["network"], row["inputs"]) == wanted
        and not row.get("forerunner")
    )
    return fmean(share for shares in error.values() for share in shares)


def errors_hold(throws: Recorded) -> bool:
    """Whether errors of networks are the shares that the page names."""
    designed, few = _error(throws, "robots", (3400, 29)), _error(throws, "robots", (500, 40))
    expected = ((_error(throws, "paper", (500, 200)), 0.85, 0.05), (designed, 1 / 4, 0.03), (few, designed, 0.05))
    return few > designed and all(math.isclose(*pair, abs_tol=tolerance) for *pair, tolerance in expected)


def larger_networks(throws: Recorded) -> Mapping[str, str]:
    """Return what magnitudes, wider and deeper networks leave of the error of 2 × 32 with six inputs."""
    error = partial(_error, throws, "robots", (3400, 29))
    shares = {"magnitudes": error(inputs=9), "wider": error("2 × 48"), "deeper": error("3 × 64")}
    return {name: percent(share / error()) for name, share in shares.items()}


def tracks_hold(tracks: Recorded) -> bool:
    """Whether tracks lose a quarter, and 2 mm of noise or 100 throws more than half, of what exact states give."""
    of = {row["learned_from"]: fmean(row["displacement"]) for row in tracks["studies"]}
    rows = [row for row in tracks["studies"] if row["learned_from"] == "tracks" and row["rate"] == 60]
    shares = {(row["n_throws"], row["noise_mm"]): fmean(row["displacement"]) / of["exact states"] for row in rows}
    quarter = (
        fmean(share for (n, noise), share in shares.items() if n == 500 and noise <= 1),
        of["video"] / of["exact states of filmed throws"],
    )
    half = (shares[500, 2.0], shares[100, 0.3])
    return all(math.isclose(share, 0.75, abs_tol=0.05) for share in quarter) and max(half) < 0.5


def _tracked(tracks: Recorded, n_throws: int, noise_mm: float) -> Share:
    """Return what tracks at 60 frames a second give of exact states."""
    (exact,) = (row for row in tracks["studies"] if row["learned_from"] == "exact states")
    (row,) = (
        row
        for row in tracks["studies"]
        if row["learned_from"] == "tracks"
        and (row["rate"], row["noise_mm"], row["n_throws"]) == (60, noise_mm, n_throws)
    )
    return share_of(row, exact)


def _shares_of_exact_states(tracks: Recorded) -> dict[str, Share]:
    """Return what tracks at 60 frames a second without noise, and the synthetic video, give of exact states."""
    by_source = {row["learned_from"]: row for row in tracks["studies"]}
    video = share_of(by_source["video"], by_source["exact states of filmed throws"])
    return {"exact": _tracked(tracks, 500, 0), "video": video}


def shares_of_exact_states(tracks: Recorded) -> dict[str, str]:
    """Return the shares of exact states in percent."""
    return {name: percent(found.value) for name, found in _shares_of_exact_states(tracks).items()}


def no_loss_of_a_quarter(tracks: Recorded) -> bool:
    """Whether neither share differs from that of exact states, and both rule out the loss of a quarter."""
    found = _shares_of_exact_states(tracks).values()
    return all(0.75 < share.low < 1 < share.high for share in found)


def _fewer_and_noisier(tracks: Recorded) -> dict[str, Share]:
    rows = {
        "noisy": (500, 0.3),
        "noisier": (500, 1.0),
        "noisiest": (500, 2.0),
        "fewer": (250, 0.3),
        "fewest": (100, 0.3),
    }
    return {name: _tracked(tracks, *row) for name, row in rows.items()}


def shares_of_fewer_and_noisier(tracks: Recorded) -> dict[str, str]:
    """Return what noise and fewer throws leave of exact states, in percent."""
    return {name: percent(found.value) for name, found in _fewer_and_noisier(tracks).items()}


def only_extremes_differ(tracks: Recorded) -> bool:
    """Whether of these only most noise and fewest throws differ from exact states beyond chance."""
    found = _fewer_and_noisier(tracks)
    return [name for name, share in found.items() if not share.low < 1 < share.high] == ["noisiest", "fewest"]


def throws_matter_most(studies: Recorded) -> bool:
    """Whether robots of the paper's throws keep little whatever the ensemble, and predictions fall with k."""
    by_name = {of["study"]: of for of in studies["studies"]}
    papers = [share(of, arm) for of in by_name.values() for arm in _arms(of) & {"residual_slush", "single_member"}]
    gaps = [shortfall(by_name[f"penalty-{k}"], "residual_slush") for k in ("0", "3")]
    return max(papers) < 1 / 3 and gaps[1] < gaps[0]


def single_networks_suffice(studies: Recorded) -> bool:
    """Whether a single network's robots of designed throws go about as far as an ensemble's."""
    by_name = {of["study"]: of for of in studies["studies"]}
    single = share(by_name["members-1"], "designed_single_member")
    ensembles = [share(of, "designed_throws") for of in by_name.values() if "designed_throws" in _arms(of)]
    return math.isclose(single, fmean(ensembles), rel_tol=2 * EQUAL)


def ensembles_matter(desk: Recorded) -> Mapping[str, str]:
    """Return what single networks and ensembles of designed throws keep of *E* at 9 m, and who exploits them."""
    zero_shot = [
        [one["zero_shot"] for one in desk["champions"] if (one["environment"], one["depth"]) == (arm, paper.DEPTH)]
        for arm in ("designed_single_member", "designed_throws")
    ]
    return {
        "single": percent(share(desk, "designed_single_member")),
        "ensemble": percent(share(desk, "designed_throws")),
        "p": f"{scipy.stats.ttest_ind(*zero_shot, equal_var=False).pvalue:.2f}",
        "exploiters": f"{n_exploiters(desk, 'designed_single_member')}",
    }


def _of_rule(rules: Recorded, arm: str, rule: str, quantity: str = "zero_shot") -> list[float]:
    chosen = [row for row in rules["rows"] if (row["arm"], row["rule"]) == (arm, rule)]
    return [value for row in chosen for value in row[quantity]]


def _p_of_rule(rules: Recorded, arm: str, rule: str) -> float:
    """Return p of Welch's t test between a rule and the paper's, zero-shot."""
    both = (_of_rule(rules, arm, name) for name in (rule, "μ − σ"))
    return float(scipy.stats.ttest_ind(*both, equal_var=False).pvalue)


def p_of_rules(rules: Recorded) -> Mapping[str, str]:
    """Return p of the rules that are farthest ahead of the paper's, one for each kind of throws."""
    return {
        "quartile": f"{_p_of_rule(rules, 'residual_slush', 'lower quartile'):.2f}",
        "calibrated": f"{_p_of_rule(rules, 'designed_throws', 'μ − k σ, k calibrated'):.2f}",
    }


def no_rule_differs(rules: Recorded) -> bool:
    """Whether no rule differs from the paper's at 5 %, with either kind of throws."""
    others = {(row["arm"], row["rule"]) for row in rules["rows"]} - {(row["arm"], "μ − σ") for row in rules["rows"]}
    return all(_p_of_rule(rules, arm, rule) > 0.05 for arm, rule in others)


def designed_throws_need_no_penalty(rules: Recorded) -> bool:
    """Whether μ alone keeps nine tenths with designed throws, and is exploited in most trials with the paper's."""
    alone, penalised = (fmean(_of_rule(rules, "designed_throws", rule)) for rule in ("μ", "μ − σ"))
    predicted, true = (_of_rule(rules, "residual_slush", "μ", quantity) for quantity in ("predicted", "zero_shot"))
    n_exploiters = sum(reached < prediction / 2 for prediction, reached in zip(predicted, true, strict=True))
    return alone > 0.9 * penalised and n_exploiters > len(true) / 2


def from_100_throws(studies: Recorded) -> Mapping[str, str]:
    """Return the shares of *E* from 100 throws: of designed throws, of the paper's, and with magnitudes as inputs."""
    six, nine = _from_100_throws(studies)
    shares = {
        "designed": share(six, "designed_throws"),
        "designed_adapted": share(six, "designed_throws", "adapted"),
        "papers": share(six, "residual_slush"),
        "papers_adapted": share(six, "residual_slush", "adapted"),
        "nine": share(nine, "designed_throws"),
    }
    return {name: percent(found) for name, found in shares.items()}


def _from_100_throws(studies: Recorded) -> list[Recorded]:
    by_name = {study["study"]: study for study in studies["studies"]}
    return [by_name["few-100"], by_name["few-100-magnitudes"]]


def below_the_aim(studies: Recorded) -> bool:
    """Whether 100 throws fall short of 90 % of *E*, with six inputs and nine, which do not differ by Welch's test."""
    both = _from_100_throws(studies)
    drawn = [
        [row["zero_shot"] for row in study["champions"] if row["environment"] == "designed_throws"] for study in both
    ]
    alike = scipy.stats.ttest_ind(*drawn, equal_var=False).pvalue > 0.05
    return bool(alike) and max(share(study, "designed_throws") for study in both) < 0.9


def _arms(study: Recorded) -> set[str]:
    return {of["environment"] for of in study["arms"]}


def _bars(video: Recorded, case: str) -> list[Recorded]:
    return [row for row in video["cases"] if row["case"] == case]


def video_holds(video: Recorded) -> bool:
    """Whether positions from videos are off by a quarter of a millimetre, most of it constant."""
    seen = [row for row in video["cases"] if "exact" not in row["case"]]
    constant = all(row["jitter_mm"] < row["position_mm"] / 2 for row in seen)
    return constant and math.isclose(fmean(row["position_mm"] for row in seen), 0.25, abs_tol=0.05)


def slow_bars_hold(video: Recorded) -> bool:
    """Whether the stated uncertainty of bars that are not fast is right within a fifth with a board."""
    slow = [row for row in video["cases"] if row["case"].endswith(", board") and row["band"][1] < 1]
    return all(abs(row["stated_mm"] / row["jitter_mm"] - 1) < 0.205 for row in slow)


def too_small(video: Recorded) -> Mapping[str, str]:
    """Return by how much the stated uncertainty of fast bars is too small, with a board and without."""
    fast = {"board": _bars(video, "60/s, board")[-1], "share": _bars(video, "60/s, no board")[-1]}
    return {name: percent(1 - row["stated_mm"] / row["jitter_mm"]) for name, row in fast.items()}


# -- benchmarks ------------------------------------------------------------------------------------------------------


def medians(benchmarks: Recorded, name: str) -> list[float]:
    """Return the medians of a benchmark over depths."""
    return [of["median"] for of in benchmarks["figures"] if of["name"].startswith(f"{name}, d = ")]


def own_work(benchmarks: Recorded) -> Mapping[str, str]:
    """Return the ranges of AFPO's own work and of its tables [%]."""
    median = {of["name"]: of["median"] for of in benchmarks["figures"]}
    arms = ("DryLand, d = 9", "TrueSlush, d = 1", "TrueSlush, d = 9")
    own = [median[f"AFPO's own work, {arm}"] for arm in arms]
    tables = [median[f"AFPO's own work and its tables, {arm}"] - of for arm, of in zip(arms, own, strict=True)]
    ends = {"low": min(own), "high": max(own), "low_tables": min(tables), "high_tables": max(tables)}
    return {name: f"{end:.0f}" for name, end in ends.items()}


def times_of_true_slush(profile: Recorded) -> Mapping[str, str]:
    """Return how much longer a generation takes with the smallest and the largest of the profiled networks."""
    seconds = {row["environment"]: row["seconds"] for row in profile["rows"]}
    networks = [of for name, of in seconds.items() if name.startswith("Residual Slush")]
    least, most = (of(networks) / seconds["True Slush"] for of in (min, max))
    return {"least": f"{least:.0f}", "most": f"{most:.0f}"}


def shares_of_peak(profile: Recorded) -> Mapping[str, str]:
    """Return the range of the networks' rates over the core's peak, over ensembles."""
    rows = [row for row in profile["rows"] if row["gflop"]]
    rates = [row["gflop"] / (row["shares"]["networks"] * row["seconds"]) / profile["peak_gflops"] for row in rows]
    return {"low": percent(min(rates)), "high": percent(max(rates))}
