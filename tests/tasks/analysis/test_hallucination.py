import numpy as np
import pytest

from tasks.analysis.hallucination import (
    acceleration,
    disagreement,
    link_states,
    member_accelerations,
    rank_exploiters,
    size,
)
from tasks.design import random_designs
from tasks.residual import Architecture
from tasks.residual.ensemble import Ensemble
from tasks.residual.network import initial_weights
from tasks.simulation import simulate
from tasks.world import LinkStates, Physics, ResidualSlush, Slush

PHYSICS = Physics()


def rng(seed=0):
    return np.random.default_rng(seed)


def exploiter(study):
    return int((study.designs.length_scale > 2.5).any(axis=1).argmax())


def test_a_planted_hallucination_is_ranked_first(study):
    """By what was predicted of it where the truth is known, and by what the members say of it where it is not."""
    liar = exploiter(study)
    unknown = np.full(len(study.true), np.nan)
    against_truth = rank_exploiters(study.predicted.mean(axis=0), study.true, unknown)
    assert (against_truth[0].rank, against_truth[0].design, against_truth[0].ranked_by) == (1, liar, "excess")
    assert against_truth[0].excess > 0.3  # of a quarter of the members, in 200 steps
    assert all(row.excess == 0 for row in against_truth[1:])  # these predictions were true

    by_outcome = rank_exploiters(study.predicted.mean(axis=0), unknown, study.predicted.std(axis=0))
    said = disagreement(study.designs, study.trace, study.planted, PHYSICS)
    by_states = rank_exploiters(study.predicted.mean(axis=0), unknown, said.by_design())
    for ranked in (by_outcome, by_states):
        assert (ranked[0].rank, ranked[0].design, ranked[0].ranked_by) == (1, liar, "disagreement")
        assert ranked[0].reason == "diverged in True Slush" and ranked[0].excess is None


def test_a_planted_hallucination_is_located(study):
    """Right member, right links, right steps, and the right thrust, to float32's rounding of a velocity over a step."""
    found = disagreement(study.designs, study.trace, study.planted, PHYSICS)
    false = study.planted.lies(link_states(study.designs, study.trace, PHYSICS))
    assert 100 < false.sum() < 0.2 * false.size and found.reason is None
    thrust, rounding = study.planted.thrust, 60 * 2**-22

    assert found.departure[study.planted.liar][false] == pytest.approx(thrust, abs=rounding)
    assert found.thrust[study.planted.liar][false] == pytest.approx(thrust, abs=rounding)
    assert not found.departure[study.planted.liar][~false].any()
    assert not np.delete(found.departure, study.planted.liar, axis=0).any()

    # One of four says 3 m/s², the others 0: a deviation of 3 √(3/16), along x alone.
    assert found.magnitude[false] == pytest.approx(thrust * np.sqrt(3) / 4, abs=rounding)
    assert not found.magnitude[~false].any()

    of_whom = found.member_thrust()[:, exploiter(study)]
    assert of_whom.argmax() == study.planted.liar and np.count_nonzero(of_whom) == 1
    assert of_whom.max() == pytest.approx(thrust * false[exploiter(study)].mean(), rel=1e-4)


def test_states_of_a_trace_are_those_that_the_engine_shows_a_medium():
    """A medium that remembers what it is asked: entry i of the trace is what it is asked in step i + 1."""
    asked = []

    class Witness:
        n_members = 1

        def velocity_change(self, links, physics):
            asked.append(links)
            return Slush().velocity_change(links, physics)

    designs = random_designs(2, rng(1))
    environment = ResidualSlush(depth=2.0, ensemble=Witness())
    trace = simulate(designs, environment, n_settle=0, n_measure=30, engine="reference", trace=True).trace
    links = link_states(designs, trace, PHYSICS)
    assert links.y.shape == (1, 2, 30, 6)
    for name in vars(links):
        seen = np.stack([getattr(state, name)[0] for state in asked[1:]], axis=1)
        read = getattr(links, name)[0, :, :-1]
        assert read == pytest.approx(seen, abs=2e-6), name  # Box2D has a cosine of its own


def test_traces_of_other_designs_are_refused():
    designs = random_designs(2, rng())
    with pytest.raises(ValueError, match=r"trace has shape \(3, 5, 6, 6\), expected \(..., 2 designs, n_steps, "):
        link_states(designs, np.zeros((3, 5, 6, 6), np.float32), PHYSICS)
    with pytest.raises(ValueError, match="trace has shape"):
        disagreement(designs, np.zeros((8, 2, 5, 6, 6), np.float32), None, PHYSICS)


def test_trained_members_are_asked_about_the_same_links(study):
    rng = np.random.default_rng(0)
    scales = {
        f"{what}_{moment}": np.full(6, value, np.float32)
        for what in ("observation", "residual")
        for moment, value in (("mean", 0.0), ("deviation", 1.0))
    }
    architecture = Architecture(hidden_layers=2, width=16)
    arrays = [{**initial_weights(architecture, rng), **scales} for _ in range(3)]
    ensemble = Ensemble.from_members(arrays)
    links = link_states(study.designs, study.trace[:, :4], PHYSICS)
    said = member_accelerations(ensemble, links, PHYSICS)
    assert said.shape == (3, 6, 4, 6, 3)
    for k in range(3):
        own = LinkStates(**{name: array[None] for name, array in vars(links).items()})
        assert (said[k] == acceleration(Ensemble.from_members([arrays[k]]), own, PHYSICS)[0]).all()
    found = disagreement(study.designs, study.trace[:, :4], ensemble, PHYSICS)
    assert found.magnitude == pytest.approx(size(said.std(axis=0), links), rel=1e-6)
    assert (found.departure >= 0).all() and found.magnitude.min() > 0


def test_the_size_of_an_acceleration_is_that_of_the_link_s_points():
    """The mean square over a 2 m × 0.5 m link of 3 kg, of a = (3, 4) and α = 2, point by point."""
    links = LinkStates(*np.array([[2.0], [3.0], [3 * (4 + 0.25) / 12], *[[0.0]] * 6]))
    x, y = np.meshgrid((np.arange(400) + 0.5) / 800 - 0.25, (np.arange(400) + 0.5) / 200 - 1)
    mean_square = np.mean((3 - 2 * y) ** 2 + (4 + 2 * x) ** 2)
    assert size(np.array([[3.0, 4.0, 2.0]]), links)[0] == pytest.approx(np.sqrt(mean_square), rel=1e-5)


def test_a_single_member_can_not_disagree(study):
    planted = type(study.planted)(n_members=1)
    found = disagreement(study.designs, study.trace, planted, PHYSICS)
    assert found.reason == "a single member can't disagree"
    assert np.isnan(found.magnitude).all() and np.isnan(found.by_design()).all()


def test_a_rollout_that_diverged_is_mapped_as_far_as_it_went(study):
    trace = study.trace.copy()
    trace[0, 10:], trace[1] = np.nan, np.nan
    found = disagreement(study.designs, trace, study.planted, PHYSICS)
    assert np.isnan(found.magnitude[0, 10:]).all() and np.isfinite(found.magnitude[0, :10]).all()
    whole = disagreement(study.designs, study.trace, study.planted, PHYSICS)
    assert (found.magnitude[2:] == whole.magnitude[2:]).all()
    means = found.by_design()
    assert np.isfinite(means[0]) and np.isnan(means[1])
    ranked = rank_exploiters(study.predicted.mean(axis=0), np.full(len(means), np.nan), means)
    assert (ranked[-1].design, ranked[-1].ranked_by) == (1, "nothing")


def test_ties_share_a_rank_and_keep_their_order():
    ranked = rank_exploiters(np.array([5.0, 9.0, 5.0, 1.0]), np.array([1.0, 2.0, 1.0, 1.0]), np.full(4, np.nan))
    found = [(row.rank, row.design, row.excess) for row in ranked]
    assert found == [(1, 1, 7.0), (2, 0, 4.0), (2, 2, 4.0), (4, 3, 0.0)]


def test_equal_excess_is_ranked_by_disagreement():
    ranked = rank_exploiters(np.full(3, 5.0), np.ones(3), np.array([0.1, 0.3, np.nan]))
    assert [(row.rank, row.design, row.disagreement) for row in ranked] == [(1, 1, 0.3), (2, 0, 0.1), (3, 2, None)]


def test_what_cannot_be_ranked_says_why():
    predicted = np.array([5.0, -np.inf, 5.0, 5.0])
    true, disagreement = np.array([[1.0, 1.0, np.nan, np.nan], [0.0, np.nan, 2.0, 3.0]])
    ranked = rank_exploiters(predicted, true, disagreement)
    assert [row.design for row in ranked] == [0, 3, 2, 1]
    assert [row.ranked_by for row in ranked] == ["excess", "disagreement", "disagreement", "nothing"]
    assert [row.reason for row in ranked] == [None, *["diverged in True Slush"] * 2, "diverged where it evolved"]
    assert ranked[-1].predicted is None
    assert rank_exploiters(*np.empty((3, 0))) == ()
    with pytest.raises(ValueError, match="shorter than argument 1"):
        rank_exploiters(predicted, np.zeros(2), disagreement)
