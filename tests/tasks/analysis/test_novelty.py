import numpy as np
import pytest

from tasks.analysis.hallucination import link_states
from tasks.analysis.novelty import novelty, thrown
from tasks.residual import Throws, initial_states, simulate_throws
from tasks.world import LinkStates, Physics, Slush

PHYSICS = Physics()


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.fixture(scope="module")
def throws():
    return simulate_throws(initial_states(Throws(n_throws=200), rng()), 50, Slush(), PHYSICS)


@pytest.fixture(scope="module")
def known(throws):
    return thrown(throws.observation, throws.throw)


def links_of(transitions):
    _, y, angle, vx, vy, omega = transitions.state.T
    one = np.ones(len(y), np.float32)
    return LinkStates(transitions.length_scale, one, one, y, np.cos(angle), np.sin(angle), vx, vy, omega)


def one_link(a=2.0, y=-1.0, angle=0.3, vx=0.0, vy=0.0, omega=0.0):
    numbers = (a, 1.0, (a**2 + a**-2) / 12, y, np.cos(angle), np.sin(angle), vx, vy, omega)
    return LinkStates(*(np.array([number], np.float32) for number in numbers))


def places(observation):
    y, cos, vx, vy, omega = np.asarray(observation, float)[..., 1:].T
    return np.stack((y, cos, np.arcsinh(2 * vx), np.arcsinh(2 * vy), np.arcsinh(2 * omega)), axis=-1)


def test_what_was_thrown_is_not_novel(throws, known):
    assert (known.usual * novelty(links_of(throws), known)).max() < 1e-4  # cosines of float32 angles, recomputed


def test_the_distance_is_to_the_nearest_of_all(throws, known):
    everything = places(throws.observation)
    offsets = (everything - places([2.0, -0.7, np.cos(0.3), 1.3, -2.0, 0.4])) / everything.std(axis=0)
    expected = np.sqrt((offsets**2).sum(axis=1).min()) / known.usual
    assert novelty(one_link(y=-0.7, vx=1.3, vy=-2.0, omega=0.4), known)[0] == pytest.approx(expected, rel=1e-5)


def test_one_is_the_median_distance_of_fresh_throws(known):
    """20 throws set the median, so a share of one half is known to about 0.5 / √20 = 0.11; twice that is allowed."""
    fresh = simulate_throws(initial_states(Throws(n_throws=100), rng(1)), 50, Slush(), PHYSICS)
    assert np.mean(novelty(links_of(fresh), known) <= 1) == pytest.approx(0.5, abs=0.22)


def test_lengths_between_those_thrown_are_no_news_and_mirror_images_are(known):
    assert novelty(one_link(a=1.5), known)[0] == novelty(one_link(a=2.0), known)[0]
    observation = rng(2).normal(size=(400, 6))
    observation[:, 5] = np.abs(observation[:, 5])  # thrown with ω > 0 alone
    one_sided = thrown(observation, np.arange(400))
    there, mirrored = (novelty(one_link(a=1, y=0, angle=1.57, omega=sign * 2.0), one_sided)[0] for sign in (1, -1))
    assert mirrored > there + 0.5 / one_sided.usual


@pytest.mark.parametrize(("component", "value"), [("y", -80.0), ("vx", 1e9), ("vy", -1e9), ("omega", 1e9)])
def test_far_from_the_throws(known, component, value):
    assert novelty(one_link(**{component: value}), known)[0] > 3


def test_what_is_unknown_is_nan(known):
    assert np.isnan(novelty(one_link(vx=np.nan), known)[0])
    single = thrown(rng().normal(size=(50, 6)), np.zeros(50, int))
    repeated = thrown(np.tile(rng().normal(size=(5, 6)), (4, 1)), np.repeat(np.arange(4), 5))
    for throws in (single, repeated):
        assert np.isnan(throws.usual) and np.isnan(novelty(one_link(), throws)[0])


def test_rollouts_are_measured_link_by_link(study, known):
    links = link_states(study.designs, study.trace[:, :5], PHYSICS)
    found = novelty(links, known)
    assert found.shape == (6, 5, 6)
    one = LinkStates(**{name: array[2, 3, 4:5] for name, array in vars(links).items()})
    assert novelty(one, known)[0] == found[2, 3, 4]


def test_observations_of_the_wrong_shape_are_refused():
    with pytest.raises(ValueError, match=r"observation has shape \(5, 3\), expected \(at least 1, 6\)"):
        thrown(np.zeros((5, 3)), np.zeros(5))
