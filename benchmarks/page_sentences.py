"""The sentences of README.md and docs/*.md whose figures or claims follow from results files, by page.

A claim in words holds within tolerances: means of displacements count as equal within a tenth.
"""

import math
from collections.abc import Mapping, Sequence
from statistics import fmean

import scipy

from benchmarks.sentences import Results, Sentence
from tasks.analysis import paper

ROW, SHALLOW, DESK, LAPTOP, MAGNITUDES = (
    f"docs/results/{name}.json" for name in ("row", "row-shallow", "desk", "laptop", "laptop-magnitudes")
)
CHOICES, ROBOT, INTERVALS, RECORDED = (
    f"docs/results/{name}.json" for name in ("open-choices", "bench-robot", "intervals", "recorded")
)
THROWS, TRACKS, VIDEO = (f"docs/results/{name}.json" for name in ("throws", "tracks", "tank-video"))
SENSITIVITY, BENCHMARKS = "docs/sensitivity.json", "benchmarks/results.json"

_EQUAL = 0.1  # relative difference of means that count as equal


def _moments(study: Results, environment: str, quantity: str, depth: float) -> Results:
    found: list[Results] = [of for of in study["arms"] if (of["environment"], of["depth"]) == (environment, depth)]
    if len(found) != 1 or quantity not in found[0]:
        raise ValueError(
            f"study {study['study']} has no {quantity} of {environment} at {depth:g} m, which a page quotes"
        )
    moments: Results = found[0][quantity]
    return moments


def _mean(study: Results, environment: str, quantity: str, depth: float = paper.DEPTH) -> float:
    mean: float = _moments(study, environment, quantity, depth)["mean"]
    return mean


def _spread(study: Results, environment: str, quantity: str) -> str:
    moments = _moments(study, environment, quantity, paper.DEPTH)
    return f"{moments['mean']:.1f} ± {moments['sd']:.1f}"


def _share(study: Results, environment: str, quantity: str = "zero_shot", of: str = "zero_shot") -> float:
    return _mean(study, environment, quantity) / _mean(study, "true_slush", of)


def _kept(study: Results, environment: str, depth: float = paper.DEPTH) -> float:
    """Return how much of its prediction an arm travels."""
    return _mean(study, environment, "zero_shot", depth) / _mean(study, environment, "predicted", depth)


def _shortfall(study: Results, environment: str) -> float:
    return _mean(study, environment, "predicted") - _mean(study, environment, "zero_shot")


def _percent(share: float) -> str:
    return f"{100 * share:.0f}".replace("-", "−")


def _fit(study: Results, learned_from: str) -> Results:
    """Return R and slope of an ensemble's mean."""
    (row,) = (row for row in study["accuracy"] if (row["learned_from"], row["name"]) == (learned_from, "mean"))
    found: Results = row
    return found


# -- studies ---------------------------------------------------------------------------------------------------------


def _of_data_sets(desk: Results) -> list[list[Results]]:
    rows = [row for row in desk["champions"] if row["environment"] == "designed_throws"]
    return [[row for row in rows if row["trial"] % 2 == k] for k in (0, 1)]


def _shares_of_data_sets(desk: Results) -> Mapping[str, str]:
    best = _mean(desk, "true_slush", "zero_shot")
    shares = [_percent(fmean(row["zero_shot"] for row in rows) / best) for rows in _of_data_sets(desk)]
    return dict(zip(("first", "second"), shares, strict=True))


def _desk_holds(desk: Results) -> bool:
    first, _ = _of_data_sets(desk)
    n_short = sum(row["zero_shot"] < 0.6 * row["predicted"] for row in first)
    return (len(first), n_short) == (5, 2) and _share(desk, "designed_throws", "adapted", "adapted") > 1 - _EQUAL


def _papers_order_holds(laptop: Results) -> bool:
    depths = sorted({arm["depth"] for arm in laptop["arms"]})
    order = ("dry_land", "residual_slush", "true_slush")
    ordered = [[_mean(laptop, name, "zero_shot", depth) for name in order] for depth in depths if depth > 0]
    arms = [[_mean(laptop, name, "zero_shot", depth) for depth in depths] for name in ("designed_throws", order[1])]
    larger_gap = all(
        _share(laptop, "residual_slush", quantity) < paper.RATIOS["residual_slush", quantity][0]
        for quantity in ("zero_shot", "adapted")
    )
    ahead = all(designed > papers for designed, papers in zip(*arms, strict=True))
    return larger_gap and ahead and all(means == sorted(means) for means in ordered)


def _designed_throws_hold(laptop: Results) -> bool:
    """Whether robots of designed throws travel as far as predicted, and almost as far as those of True Slush."""
    fit, close = _fit(laptop, "designed_throws"), _share(laptop, "designed_throws")
    predicts = fit["r"] > 0.9 and math.isclose(fit["slope"], 1, abs_tol=_EQUAL)
    return predicts and close > 0.85 and abs(_kept(laptop, "designed_throws") - 1) < _EQUAL


def _t_tests(laptop: Results) -> Mapping[str, str]:
    n = laptop["t_tests"]
    counts = {"all": sum(n.values()), "same": n["agrees"], "other": n["differs"], "untold": n["cannot tell"]}
    return {name: f"{count}" for name, count in counts.items()}


def _magnitudes_hold(laptop: Results, magnitudes: Results) -> bool:
    papers, designed = (
        [_mean(study, name, "zero_shot") for study in (laptop, magnitudes)]
        for name in ("residual_slush", "designed_throws")
    )
    return papers[1] < papers[0] and math.isclose(*designed, rel_tol=_EQUAL)


# -- why our E goes farther ------------------------------------------------------------------------------------------


def _choices(choices: Results, *wanted: str) -> list[Results]:
    return [row for row in choices["rows"] if row["setting"] and row["setting"].partition("=")[0] in wanted]


def _redrawn(choices: Results) -> Results:
    (row,) = (row for row in choices["rows"] if row["setting"] == "evolution.afpo.mutation.changed_genes=redraw")
    found: Results = row
    return found


def _variation(choices: Results) -> Mapping[str, str]:
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


def _repeated(choices: Results) -> tuple[float, float]:
    """Return the 95 % interval of the mean of the paper's ten trials, if they resampled genes as ours did."""
    row = _redrawn(choices)
    error = row["sd"] * math.sqrt(1 / row["n"] + 1 / paper.N_TRIALS)
    half = float(scipy.stats.t.ppf(0.975, row["n"] - 1)) * error
    return row["mean"] - half, row["mean"] + half


def _variation_holds(choices: Results) -> bool:
    ours, row, (low, high) = choices["rows"][0], _redrawn(choices), _repeated(choices)
    moments = [of[name] for of in (ours, row) for name in ("mean", "sd", "n")]
    p = float(scipy.stats.ttest_ind_from_stats(*moments, equal_var=False).pvalue)
    return p < 0.001 and row["mean"] < ours["mean"] and low < paper.MEANS["true_slush", "zero_shot"][0] < high


def _small_effects(choices: Results) -> Mapping[str, str]:
    ours, papers = choices["rows"][0]["mean"], paper.MEANS["true_slush", "zero_shot"][0]
    small = _choices(choices, "slush.drag", "slush.drag_integration", "physics.spawn")
    small += [row for row in choices["rows"] if row["setting"] == "physics.motor_gain=3"]
    return {"most": f"{max(abs(row['mean'] - ours) for row in small):.0f}", "gap": f"{ours - papers:.1f}"}


def _reach(choices: Results) -> Mapping[str, str]:
    reaching = _choices(choices, "physics.range_of_motion", "physics.motor_gain")
    com = sorted(row["com"] for row in reaching if row["setting"] != "physics.motor_gain=3")
    return {"low": f"{com[0]:.1f}", "high": f"{com[-1]:.1f}"}


def _sensitivity_holds(sensitivity: Results) -> bool:
    """Whether intervals of the differences, in means of the base, are as the sentence says of its four variants."""
    found = {row["name"]: row for row in sensitivity["rows"]}
    within = [_interval(found[name]) for name in ("joint-limits", "motors-after-settling")]
    beyond = [_interval(found[name]) for name in ("peak-to-peak", "tournaments")]
    bound = paper.NEGLIGIBLE
    return all(-bound < low and high < bound for low, high in within) and all(
        high < -bound or low > bound for low, high in beyond
    )


def _interval(row: Results) -> tuple[float, float]:
    base, variant = row["base"], row["displacement"]
    found = scipy.stats.ttest_ind(variant, base).confidence_interval()
    return found.low / fmean(base), found.high / fmean(base)


# -- throws, tracks, videos ------------------------------------------------------------------------------------------


def _error(throws: Results, n_throws: int, network: str = "2 × 32", inputs: int = 6, of: str = "robots") -> float:
    """Return the mean error of networks over depths and components, with about 100,000 transitions or fewer."""
    (error,) = (
        row["error"]
        for row in throws["errors"]
        if (row["throws"], row["n_throws"], row["network"], row["inputs"]) == (of, n_throws, network, inputs)
        and row["n_steps"] in (40, 200)
        and (of, row["n_steps"]) != ("robots", 200)
    )
    return fmean(share for shares in error.values() for share in shares)


def _errors_hold(throws: Results) -> bool:
    designed = _error(throws, 2500)
    expected = (
        (_error(throws, 500, of="paper"), 1, 0.2),
        (designed, 1 / 5, 0.05),
        (_error(throws, 500), 1 / 4, 0.05),
        (_error(throws, 2500, inputs=9) / designed, 2 / 3, 0.1),
        (_error(throws, 2500, "3 × 64") / designed, 1 / 2, 0.1),
    )
    return all(math.isclose(found, stated, abs_tol=tolerance) for found, stated, tolerance in expected)


def _tracks_hold(tracks: Results) -> bool:
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


def _bars(video: Results, case: str) -> list[Results]:
    return [row for row in video["cases"] if row["case"] == case]


def _video_holds(video: Results) -> bool:
    seen = [row for row in video["cases"] if "exact" not in row["case"]]
    with_board = [row for row in seen if "no board" not in row["case"]]
    right = [abs(row["stated_mm"] / row["jitter_mm"] - 1) for row in with_board]
    return math.isclose(fmean(row["position_mm"] for row in seen), 0.25, abs_tol=0.05) and max(right) < 0.35


def _too_small(video: Results) -> Mapping[str, str]:
    fast = _bars(video, "60/s, no board")[-1]
    return {"share": _percent(1 - fast["stated_mm"] / fast["jitter_mm"])}


# -- benchmarks ------------------------------------------------------------------------------------------------------


def _medians(benchmarks: Results, name: str) -> list[float]:
    return [of["median"] for of in benchmarks["figures"] if of["name"].startswith(f"{name}, d = ")]


def _own_work(benchmarks: Results) -> Mapping[str, str]:
    median = {of["name"]: of["median"] for of in benchmarks["figures"]}
    arms = ("DryLand, d = 9", "TrueSlush, d = 1", "TrueSlush, d = 9")
    own = [median[f"AFPO's own work, {arm}"] for arm in arms]
    tables = [median[f"AFPO's own work and its tables, {arm}"] - of for arm, of in zip(arms, own, strict=True)]
    ends = {"low": min(own), "high": max(own), "low_tables": min(tables), "high_tables": max(tables)}
    return {name: f"{end:.0f}" for name, end in ends.items()}


# -- pages -----------------------------------------------------------------------------------------------------------


def _recorded(words: str, name: str) -> Sentence:
    """Return a sentence with the figures of a recorded measurement."""
    return Sentence(words, (RECORDED,), lambda recorded: recorded[name]["figures"])


SENTENCES: Mapping[str, Sequence[Sentence]] = {
    "README.md": (
        Sentence(
            "A single network's robots fall {metres} m short of its prediction, and the ensemble's do as well as it "
            "says.",
            (ROW,),
            lambda row: {"metres": f"{_shortfall(row, 'single_member'):.0f}"},
            lambda row: abs(_kept(row, "residual_slush") - 1) < _EQUAL,
        ),
        Sentence(
            "[throws designed for robots](docs/throws.md) close most of the gap.",
            (LAPTOP,),
            holds=lambda laptop: _share(laptop, "designed_throws") > (1 + _share(laptop, "residual_slush")) / 2,
        ),
        Sentence(
            "`simulate` steps all designs at once, {least} to {most} times as fast as Box2D's own `Step`",
            (BENCHMARKS,),
            lambda benchmarks: {
                name: f"{of(_medians(benchmarks, 'Step alone over batch')):.0f}"
                for name, of in (("least", min), ("most", max))
            },
        ),
    ),
    "docs/results.md": (
        Sentence(
            "Robots evolved under the ensemble travel as far as it predicts; robots evolved under a single network do "
            "not. The shares of *E* agree with the paper's.",
            (ROW,),
            holds=lambda row: (
                abs(_kept(row, "residual_slush") - 1) < _EQUAL
                and _kept(row, "single_member") < 1 - _EQUAL
                and all(
                    math.isclose(_share(row, *arm), share, abs_tol=paper.NEGLIGIBLE_RATIO)
                    for arm, (share, _) in paper.RATIOS.items()
                )
            ),
        ),
        Sentence(
            "The share of *E* zero-shot is {first} % with the first data set and {second} % with the second: of the "
            "first one's five champions, two travel half as far as predicted. Adapted, all ten trials together reach "
            "*E* adapted.",
            (DESK,),
            _shares_of_data_sets,
            _desk_holds,
        ),
        Sentence(
            "Champions evolved in true slush at 9 m travel {ours} m here",
            (ROW,),
            lambda row: {"ours": _spread(row, "true_slush", "zero_shot")},
        ),
        Sentence(
            "Variation operators alone move *E* from {low} to {high} m with the same physics. If a changed gene is "
            "resampled uniformly, *E* travels {redrawn} m over {n} trials: less than with our default (Welch's test, "
            "p < 0.001), and a repetition with the paper's 10 trials would give {least} to {most} m, which includes "
            "its 13.6 m.",
            (CHOICES,),
            _variation,
            _variation_holds,
        ),
        Sentence("none accounts for more than about {most} m of the {gap} m.", (CHOICES,), _small_effects),
        Sentence("displacement is a root that swings forwards (CoM {low} and {high} m)", (CHOICES,), _reach),
        Sentence("(ours travel {ours} m)", (ROW,), lambda row: {"ours": _spread(row, "dry_land", "predicted")}),
        Sentence(
            "with {n} trials of each, joint limits and motors that start after settling are negligible, and again a "
            "peak-to-peak range and tournaments matter.",
            (SENSITIVITY,),
            lambda sensitivity: {"n": f"{sensitivity['n_trials']}"},
            _sensitivity_holds,
        ),
        Sentence(
            "At 1 and 3 m the ensemble's robots travel as far as predicted. At 0.5 m they travel {ensemble} % of the "
            "prediction, because one of three falls short. A single member's robots travel {at_half} % of the "
            "prediction at 0.5 m, {at_one} % at 1 m and {at_three} % at 3 m.",
            (SHALLOW,),
            lambda shallow: {
                name: _percent(_kept(shallow, environment, depth))
                for name, environment, depth in (
                    ("ensemble", "residual_slush", 0.5),
                    ("at_half", "single_member", 0.5),
                    ("at_one", "single_member", 1),
                    ("at_three", "single_member", 3),
                )
            },
            lambda shallow: all(abs(_kept(shallow, "residual_slush", depth) - 1) < _EQUAL for depth in (1, 3)),
        ),
        Sentence(
            "In slush the order is the paper's, and robots of designed throws are ahead of those of the "
            "paper's throws at every depth. With the paper's throws the gap at 9 m is larger than in the paper, "
            "{zero_shot} % and {adapted} % of *E* where it has 67 % and 87 %",
            (LAPTOP,),
            lambda laptop: {
                quantity: _percent(_share(laptop, "residual_slush", quantity)) for quantity in ("zero_shot", "adapted")
            },
            _papers_order_holds,
        ),
        Sentence(
            "With designed throws the same networks close it, and predict what robots do:",
            (LAPTOP,),
            holds=_designed_throws_hold,
        ),
        Sentence(
            "{same} of the paper's {all} t tests have the same outcome, {other} have another, and {untold} are "
            "undecided with so few trials.",
            (LAPTOP,),
            _t_tests,
            lambda laptop: not laptop["t_tests"]["not comparable"],
        ),
        _recorded("*Ê* travelled {one} m and {other} m zero-shot at 9 m.", "two_machines"),
        Sentence(
            "where it ends between {behind} cm behind its start and {ahead} cm ahead of it. Of the {n} champions, "
            "{filled} cross the filled tank in every trial and the dry floor in none, {immobile} of them without "
            "leaving their place; {both} cross both in at least one trial. If the simulation's frequencies are kept, "
            "{filled_kept} trials cross the filled tank and {dry_kept} the dry floor.",
            (ROBOT,),
            lambda robot: {
                "behind": f"{-robot['proposed']['ends_on_the_dry_floor_cm'][0]}",
                "ahead": f"{robot['proposed']['ends_on_the_dry_floor_cm'][1]}",
                "n": f"{robot['champions']['n']}",
                "filled": f"{robot['champions']['filled_always_and_dry_never']}",
                "immobile": f"{robot['champions']['of_these_immobile']}",
                "both": f"{robot['champions']['both_at_least_once']}",
                "filled_kept": f"{robot['at_kept_frequencies']['filled']}",
                "dry_kept": f"{robot['at_kept_frequencies']['dry']}",
            },
        ),
        Sentence(
            "Settled, {higher} of the {n} are higher than its walls of 270 mm, filled or drained, and so is the "
            "proposed one, which stands {height} cm high in the filled tank.",
            (ROBOT,),
            lambda robot: {
                "higher": f"{robot['champions']['higher_than_the_tank']}",
                "n": f"{robot['champions']['n']}",
                "height": f"{robot['proposed']['height_in_the_filled_tank_cm']}",
            },
        ),
        Sentence(
            "{share} % of the samples show no variance between them",
            (INTERVALS,),
            lambda intervals: {"share": _percent(intervals["two_without_variance_between"])},
        ),
    ),
    "docs/throws.md": (
        _recorded("links of robots move at {slow} to {fast} m/s, turn at less than {spin} rad/s", "links"),
        Sentence(
            "The paper's throws leave errors as large as the residual itself. Designed throws leave a fifth, with as "
            "many transitions, and still a quarter with a fifth of them.",
            (THROWS,),
            holds=_errors_hold,
        ),
        Sentence(
            "Robots learned from designed throws travel as far as the ensemble predicts, and almost as far as those "
            "that evolved in true slush. With a single network they do not do as well",
            (LAPTOP,),
            holds=lambda laptop: (
                _designed_throws_hold(laptop)
                and _share(laptop, "designed_single_member") < (1 - _EQUAL) * _share(laptop, "designed_throws")
            ),
        ),
        Sentence(
            "With networks that observe magnitudes, the paper's throws lose, and designed throws do not gain where "
            "robots get",
            (LAPTOP, MAGNITUDES),
            holds=_magnitudes_hold,
        ),
        _recorded(
            "robots of designed throws go as far in this study, {designed} m of {designed_predicted} m predicted, "
            "while those of the paper's throws go {papers} m of {papers_predicted} m.",
            "no_penalty",
        ),
        _recorded(
            "{papers} % of the states of robots evolved in 9 m of *E* are outside the paper's throws, and {designed} % "
            "outside the designed ones; at 2 m, {papers_2m} % and {designed_2m} %. Without designed throws at |ω| "
            "above 1 rad/s it would be {slow} % at 9 m, {spin} % of all because of their spin (2 m: {slow_2m} % and "
            "{spin_2m} %).",
            "states_outside",
        ),
    ),
    "docs/your-own-tank.md": (
        Sentence(
            "500 throws tracked at 60 frames a second with up to 1 mm of noise lose a quarter of what exact states "
            "give, and so do those of the synthetic video. 2 mm of noise, or 100 throws in place of 500, lose more "
            "than half.",
            (TRACKS,),
            holds=_tracks_hold,
        ),
        _recorded(
            "err by {vx}, {vy} and {omega} of the deviation in vx, vy and ω along the paths of robots, and those that "
            "learned from exact states by {exact_vx}, {exact_vy} and {exact_omega}.",
            "errors_of_tracks",
        ),
    ),
    "docs/filming.md": (
        Sentence("Positions are off by a quarter of a millimetre, most of it constant", (VIDEO,), holds=_video_holds),
        Sentence("without one it is {share} % too small for fast bars", (VIDEO,), _too_small),
    ),
    "docs/bench-robot.md": (
        _recorded(
            "its three champions were predicted to travel {predicted_1}, {predicted_2} and {predicted_3} m and "
            "travelled {true_1}, {true_2} and {true_3} m in 2 m of true slush; networks this small leave much to "
            "luck. The proposed one, the second, crosses the tank in {seconds} s of simulation, {bench_seconds} s on "
            "the bench, {speed} mm/s. The third takes {seconds_of_third} s, and the first swims the wrong way. On the "
            "dry floor of the tank the second crosses in {seconds_on_dry_floor} s and the others stay where they are.",
            "raft",
        ),
        _recorded(
            "It travels {metres} m in {seconds} s in 2 m of true slush, which is {bench_cm} cm in {bench_seconds} s on "
            "the bench",
            "buildable",
        ),
        _recorded(
            "one joint must turn at {spin} rad/s, and a ds3225 servo reaches {fastest} at most, so no timeline can be "
            "written; and two joints need {torque_1} and {torque_2} times the torque",
            "raft",
        ),
    ),
    "docs/performance.md": (
        Sentence(
            "AFPO's own work is to ask, tell, pack designs into lanes and record what happened: {low} to {high} % of a "
            "generation in environments without networks, most where a generation is cheapest, in true slush at 9 m. "
            "The Parquet tables that record it add {low_tables} to {high_tables} %.",
            (BENCHMARKS,),
            _own_work,
        ),
    ),
}
