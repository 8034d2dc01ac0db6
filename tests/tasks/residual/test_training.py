from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from tasks.residual import Architecture, MeasuredTransitions, Throws, Training, Transitions
from tasks.residual.forms import observe
from tasks.residual.forms.plain import PLAIN
from tasks.residual.throws import initial_states, precision_weights, simulate_throws
from tasks.residual.training import TrainingDiverged, split_throws, train_member
from tasks.world import Physics, Slush

SMALL = Architecture(hidden_layers=2, width=16)
SHORT = Training(n_iterations=20, batch_size=256)


def synthetic(n_throws, n_steps, residual_of=lambda observed: 0.1 * observed):
    """Transitions with random observations and a residual that is a function of them; the rest is not looked at."""
    rng, n = np.random.default_rng(0), n_throws * n_steps
    none = np.zeros((n, 6), np.float32)
    drawn = Transitions(
        throw=np.repeat(np.arange(n_throws), n_steps),
        step=np.tile(np.arange(n_steps), n_throws),
        length_scale=rng.uniform(1, 3, n),
        state=rng.normal(size=(n, 6)).astype(np.float32),
        next_in_target=none,
        next_on_dry_land=none,
        residual=none,
    )
    return replace(drawn, residual=residual_of(observe(PLAIN, drawn.links(Physics()))).astype(np.float32))


def thrown(n_throws):
    starts = initial_states(Throws(n_throws=n_throws), np.random.default_rng(5))
    return simulate_throws(starts, 200, Slush(), Physics())


def test_throws_never_seen_are_predicted_much_better_than_by_the_mean():
    # With 40 throws a single impact unlike all others can outweigh the rest; 200 leave some 50 to be judged by.
    training = Training(n_iterations=3000, batch_size=1024, loss="mse", learning_rate=5e-3, held_out=0.25)
    member = train_member(thrown(200), Architecture(hidden_layers=2, width=32), training, seed=0, member=0)
    curve = member.learning_curve
    assert curve[0, 0] == 30 and curve[-1, 0] == 3000 and curve.shape == (100, 3)
    assert curve[-1, 1] < 0.3 * curve[0, 1]
    r2 = [row.r2 for row in member.validation if row.band == "all"]
    assert len(r2) == 6 and min(r2) > 0.5, r2
    (bias,) = (row.bias for row in member.validation if (row.component, row.band) == ("vx", "< 0.5"))
    assert abs(bias) < 0.02  # of what would be a thrust that does not exist [m/s a step]


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_data_that_are_not_finite_end_a_training_by_name(value):
    spoiled = synthetic(10, 5, lambda observed: np.where(np.arange(6) == 3, value, observed))
    with pytest.raises(TrainingDiverged, match=r"member 4: the training loss is nan at iteration 1\b"):
        train_member(spoiled, SMALL, SHORT, seed=0, member=4)


@pytest.mark.parametrize("wrong", [{"n_iterations": 0}, {"held_out": 1.0}, {"min_learning_rate": 1e-2}, {"unknown": 1}])
def test_wrong_settings_are_refused(wrong):
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        Training(**wrong)


def test_uncertain_residuals_weigh_less():
    residual = np.random.default_rng(1).normal(size=(1000, 6)).astype(np.float32)
    sd = np.zeros_like(residual)
    sd[1], sd[2] = 0.1, 1.0
    weights = precision_weights(residual, sd * residual.std(axis=0))
    np.testing.assert_allclose(weights[:3, 0], [1.0, 1 / 2, 1 / 101], rtol=1e-4)  # 1 / (1 + (sd / 0.1 deviations)²)


def test_a_network_learns_around_rows_that_are_known_to_be_wrong():
    plain = synthetic(20, 30)
    wrong = np.arange(len(plain)) % 3 == 0
    residual = plain.residual + 5 * wrong[:, None].astype(np.float32)
    sd = np.where(wrong[:, None], np.float32(10), np.float32(0)) * np.ones_like(residual)
    columns = plain.columns() | {"residual": residual}
    training = Training(n_iterations=300, batch_size=128, learning_rate=1e-2, loss="mse", held_out=0.1)
    architecture = Architecture(hidden_layers=1, width=16, dropout=0.0)
    of_all, of_known = (
        train_member(data, architecture, training, seed=1, member=0)
        for data in (Transitions(**columns), MeasuredTransitions(**columns, residual_sd=sd, held_out=plain.throw < 2))
    )
    assert of_known.learning_curve[-1, 2] < 0.05 * of_all.learning_curve[-1, 2]


def test_members_learn_from_other_tracked_throws_and_are_tested_on_those_that_are_held_out():
    plain = synthetic(12, 30)
    columns = plain.columns() | {"throw": plain.throw - 4, "residual_sd": np.zeros_like(plain.residual)}
    tracked = MeasuredTransitions(**columns, held_out=plain.throw < 7)
    first, again, second = (train_member(tracked, SMALL, SHORT, seed=1, member=member) for member in (0, 0, 1))
    assert {row.n_rows for row in first.validation if row.band == "all"} == {7 * 30}
    means = [member.standardisation.residual_mean for member in (first, again, second)]
    assert (means[0] == means[1]).all() and (means[0] != means[2]).all()
    spoiled = replace(tracked, residual=np.where(tracked.held_out[:, None], 9, tracked.residual).astype(np.float32))
    of_spoiled = train_member(spoiled, SMALL, SHORT, seed=1, member=0)
    assert (of_spoiled.standardisation.residual_mean == means[0]).all()


def test_standardisation_knows_the_training_set_alone():
    throws = thrown(40)
    member = train_member(throws, SMALL, SHORT, seed=3, member=0)
    learned, held_out = split_throws(throws.throw, SHORT.held_out, seed=3)
    mean = throws.residual[learned].mean(axis=0, dtype=float).astype(np.float32)
    assert (member.standardisation.residual_mean == mean).all()
    assert {row.n_rows for row in member.validation if row.band == "all"} == {held_out.sum()} == {4 * 200}


def test_whole_throws_are_held_out():
    throw = np.random.default_rng(0).permutation(np.repeat(np.arange(50), 7))
    learned, validated = split_throws(throw, 0.1, seed=1)
    assert len(set(throw[validated])) == 5 and validated.sum() == 35
    assert (learned != validated).all() and set(throw[validated]).isdisjoint(throw[learned])
    assert set(throw[split_throws(throw, 0.1, seed=2)[1]]) != set(throw[validated])


@pytest.mark.parametrize("share", [0.01, 0.99])
def test_at_least_one_throw_is_held_out_and_not_all(share):
    learned, validated = split_throws(np.array([3, 9]), share, seed=0)
    assert learned.sum() == validated.sum() == 1
