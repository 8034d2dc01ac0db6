from dataclasses import replace

import numpy as np
import pytest

from tasks.analysis.attribution import attribute, transfer_matrix
from tasks.analysis.comparison import nested_ratio
from tasks.analysis.replicates import mean_of, sum_of_means
from tasks.analysis.scores import Scores
from tasks.analysis.uncertainty import Estimate


def rng(seed=0):
    return np.random.default_rng(seed)


def table(**arms):
    """Scores at 9 m; each arm is predicted, zero-shot and adapted displacements."""
    rows = [
        (arm, trial, *values)
        for arm, columns in arms.items()
        for trial, values in enumerate(zip(*columns, strict=True))
    ]
    evolved_in, trial, predicted, zero_shot, adapted = (np.array(column) for column in zip(*rows, strict=True))
    return Scores(evolved_in, np.full(len(rows), 9.0), trial, predicted, zero_shot, adapted)


NAN = float("nan")
E = ([9.0, 10.0, 11.0], [9.0, 10.0, 11.0], [13.0, 14.0, 15.0])  # best 10, and 14 once adapted


def test_a_worked_example():
    """The gap is 10 - 2 = 8; a new controller recovers 5, and 3 are the body's."""
    dry_land = ([60.0, 50.0, 70.0], [1.0, 2.0, 3.0], [6.0, 8.0, 7.0])
    (found,) = attribute(table(true_slush=E, dry_land=dry_land), rng=rng())
    assert (found.evolved_in, found.depth, found.n, found.n_best) == ("dry_land", 9.0, 3, 3)
    figures = {name: value.value for name, value in vars(found).items() if hasattr(value, "value")}
    assert figures == pytest.approx(
        {
            "predicted": 60,
            "zero_shot": 2,
            "adapted": 7,
            "best": 10,
            "best_adapted": 14,
            "hallucinated": 58,
            "gap": 8,
            "lost_to_controller": 5,
            "lost_to_body": 3,
            "lost_to_body_equally_searched": 7,
            "controller_share": 5 / 8,
            "body_share": 3 / 8,
            "recovered_zero_shot": 0.2,
            "recovered_adapted": 0.7,
            "recovered_zero_shot_of_adapted": 2 / 14,
            "recovered_adapted_equally_searched": 0.5,
            "recovered_of_dry_land": None,
        }
    )
    assert found.recovered_of_dry_land.reason == "it is the reference"


def test_how_much_of_dry_land_s_damage_is_undone():
    dry, residual = ([60.0] * 3, [1.0, 2.0, 3.0], [6.0] * 3), ([8.0] * 3, [5.0, 6.0, 7.0], [9.0] * 3)
    _, found = attribute(table(true_slush=E, dry_land=dry, residual_slush=residual), rng=rng())
    assert found.evolved_in == "residual_slush"
    assert found.recovered_of_dry_land.value == pytest.approx((6 - 2) / (10 - 2))


def test_intervals_hold_the_shares():
    """95 % of 300 intervals with 10 trials, give or take four binomial deviations of 0.0126."""
    draw, inside = rng(1), 0
    for seed in range(300):
        skill = draw.normal(0, 1, 10)  # a good body is good with either controller: trials keep their pairs
        arm = ([0.0] * 10, 3 + skill, 6 + skill + draw.normal(0, 1, 10))
        best = draw.normal(12, 1.5, 10)
        (found,) = attribute(table(true_slush=(best, best, best), dry_land=arm), rng=rng(seed))
        inside += found.controller_share.low <= 3 / 9 <= found.controller_share.high
    assert abs(inside / 300 - 0.95) < 4 * 0.0126


def test_the_parts_add_up_in_every_estimate():
    draw = rng(2)
    arm = (draw.normal(20, 1, 6), draw.normal(3, 1, 6), draw.normal(6, 1, 6))
    best = draw.normal(12, 1, 6)
    (found,) = attribute(table(true_slush=(best,) * 3, single_member=arm), rng=rng())
    assert found.gap.value == pytest.approx(found.lost_to_controller.value + found.lost_to_body.value)
    assert found.controller_share.value + found.body_share.value == pytest.approx(1)
    # A part of the whole and its complement have mirrored intervals of the same resamples (up to quantile steps).
    assert found.controller_share.low == pytest.approx(1 - found.body_share.high, abs=0.01)


def replicated(scores, n_replicates=2):
    """The same scores of trials that take turns over the replicates, but for those of True Slush."""
    return replace(scores, replicate=np.where(scores.evolved_in == "residual_slush", scores.trial % n_replicates, 0))


def test_estimates_include_the_variance_between_replicates():
    """Two replicates 4 m apart, three trials each that differ by 1 m: the same values, and other intervals."""
    z = np.array([1.0, 5.0, 2.0, 6.0, 3.0, 7.0])
    arm, dry, best = (z + 1, z, z + 3), (z, z - 2, z - 1), np.linspace(10, 12, 6)
    scores = table(true_slush=(best, best, best + 1), dry_land=dry, residual_slush=arm)
    _, plain = attribute(scores, rng=rng())
    untouched, found = attribute(replicated(scores), rng=rng())
    assert untouched == attribute(scores, rng=rng())[0]  # Dry Land depends on no replicate
    for name, of in vars(found).items():
        if isinstance(of, Estimate):
            assert of.value == pytest.approx(getattr(plain, name).value), name
    samples = [
        replicated(scores).sample(*of, 9.0) for of in (("residual_slush", "zero_shot"), ("true_slush", "zero_shot"))
    ]
    assert found.zero_shot == mean_of(samples[0]) and found.best == mean_of(samples[1]) == plain.best
    assert found.gap == sum_of_means(samples[1], samples[0].scaled(-1))
    assert found.recovered_zero_shot == nested_ratio(*samples, rng=rng())
    assert (
        found.lost_to_controller.reason == found.hallucinated.reason == "no interval, since the values have no spread"
    )
    for wider in ("zero_shot", "gap", "lost_to_body", "recovered_adapted", "controller_share", "recovered_of_dry_land"):
        ends, of_plain = getattr(found, wider), getattr(plain, wider)
        assert ends.high is None or ends.high - ends.low > 3 * (of_plain.high - of_plain.low), wider


def test_shares_of_replicates_hold_the_truth():
    """A share and its complement have mirrored intervals; of three replicates of four trials, 94 % of 300 hold it."""
    draw, inside = rng(3), 0
    for _ in range(300):
        skill = draw.normal(0, 0.7, 3)[np.arange(12) % 3] + draw.normal(0, 0.7, 12)
        best = draw.normal(12, 1, 12)
        arm = (skill, 3 + skill, 6 + skill + draw.normal(0, 1, 12))
        (found,) = attribute(replicated(table(true_slush=(best,) * 3, residual_slush=arm), 3), rng=draw)
        share, rest = found.controller_share, found.body_share
        assert (share.low, share.high) == pytest.approx((1 - rest.high, 1 - rest.low))
        inside += share.low <= 3 / 9 <= share.high
    assert abs(inside / 300 - 0.94) < 4 * 0.0137


def test_trials_without_both_scores_are_not_in_the_split():
    arm = ([1.0] * 3, [1.0, 2.0, 300.0], [6.0, 8.0, NAN])
    (found,) = attribute(table(true_slush=E, dry_land=arm), rng=rng())
    assert found.n == 2 and found.gap.value == pytest.approx(8.5) and found.zero_shot.value == pytest.approx(101)


def test_without_adaptation_or_reference_the_rest_is_there():
    (found,) = attribute(table(true_slush=E, dry_land=([9.0] * 3, [1.0, 2.0, 3.0], [NAN] * 3)), rng=rng())
    expected = "0 trials scored zero-shot and adapted and 3 in True Slush, expected 1 or more"
    assert found.gap.reason == found.body_share.reason == expected
    assert found.adapted.reason == "no finite value" and found.recovered_zero_shot.value == pytest.approx(0.2)
    (alone,) = attribute(table(residual_slush=([9.0] * 3, [1.0, 2.0, 3.0], [5.0] * 3)), rng=rng())
    assert alone.best.value is None and alone.recovered_zero_shot.value is None
    assert alone.recovered_of_dry_land.reason == "no finite score of: True Slush, Dry Land zero-shot"


def test_where_there_is_no_gap_there_are_no_shares():
    (found,) = attribute(table(true_slush=E, dry_land=([9.0] * 3, [12.0] * 3, [13.0] * 3)), rng=rng())
    assert found.gap.value == -2 and found.lost_to_body.value == -3
    assert found.body_share.value is None and found.body_share.reason == "there is no gap to take shares of"


def test_a_transfer_matrix():
    found = transfer_matrix(
        trained=[9, 9, 0.5, 0.5, 9, 9],
        tested=[0.5, 0.5, 0.5, 0.5, 9, 4],
        displacement=np.array([10, 14, 24, NAN, 8, 5]),
    )
    assert found.trained.tolist() == [0.5, 9] and found.tested.tolist() == [0.5, 4, 9]
    assert found.n.tolist() == [[1, 0, 0], [2, 1, 1]]
    assert found.mean == pytest.approx(np.array([[24, NAN, NAN], [12, 5, 8]]), nan_ok=True)
    assert found.sd == pytest.approx(np.array([[NAN] * 3, [8**0.5, NAN, NAN]]), nan_ok=True)
    assert found.relative == pytest.approx(np.array([[1, NAN, NAN], [0.5, NAN, 1]]), nan_ok=True)
