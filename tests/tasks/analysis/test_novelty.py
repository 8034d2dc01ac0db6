import numpy as np
import pytest

from tasks.analysis.hallucination import link_states
from tasks.analysis.member_error import thrown_links
from tasks.analysis.novelty import SPACE, novelty, thrown
from tasks.residual import Throws, initial_states, simulate_throws
from tasks.world import LinkStates, Physics, Slush

PHYSICS = Physics()


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.fixture(scope="module")
def throws():
    starts = initial_states(Throws(n_throws=200), rng())
    return simulate_throws(starts, 50, Slush(), PHYSICS)


@pytest.fixture(scope="module")
def known(throws):
    return thrown(throws.observation, throws.throw)


def one_link(a=2.0, y=-1.0, angle=0.3, vx=0.0, vy=0.0, omega=0.0):
    numbers = (a, 1.0, (a**2 + a**-2) / 12, y, np.cos(angle), np.sin(angle), vx, vy, omega)
    return LinkStates(*(np.array([number], np.float32) for number in numbers))


def test_what_was_thrown_is_not_novel(throws, known):
    found = novelty(thrown_links(throws, PHYSICS), known)
    assert found.distance.max() < 1e-4  # cosines of float32 angles, recomputed
    assert found.distance.shape == found.component.shape == (10_000,)


def places(observation):
    y, cos, vx, vy, omega = np.asarray(observation, float)[..., 1:].T
    return np.stack((y, cos, np.arcsinh(2 * vx), np.arcsinh(2 * vy), np.arcsinh(2 * omega)), axis=-1)


def test_the_distance_is_to_the_nearest_of_all(throws, known):
    here = places([2.0, -0.7, np.cos(0.3), 1.3, -2.0, 0.4])
    everything = places(throws.observation)
    offsets = (everything - here) / everything.std(axis=0)
    nearest = (offsets**2).sum(axis=1).argmin()
    found = novelty(one_link(y=-0.7, vx=1.3, vy=-2.0, omega=0.4), known)
    assert found.distance[0] == pytest.approx(np.sqrt((offsets[nearest] ** 2).sum()), rel=1e-5)
    assert found.component[0] == np.abs(offsets[nearest]).argmax()
    assert found.novelty[0] == found.distance[0] / known.usual


def test_one_is_the_median_distance_of_fresh_throws(known):
    """20 throws set the median, so a share of one half is known to about 0.5 / √20 = 0.11; twice that is allowed."""
    fresh = simulate_throws(initial_states(Throws(n_throws=100), rng(1)), 50, Slush(), PHYSICS)
    assert np.mean(novelty(thrown_links(fresh, PHYSICS), known).novelty <= 1) == pytest.approx(0.5, abs=0.22)


def test_lengths_between_those_thrown_are_no_news(known):
    assert novelty(one_link(a=1.5), known).distance[0] == novelty(one_link(a=2.0), known).distance[0]


FAR = [("y", -80.0), ("vx", 1e9), ("vy", -1e9), ("omega", 1e9)]


@pytest.mark.parametrize(("component", "value"), FAR)
def test_far_from_the_throws_says_how(known, component, value):
    found = novelty(one_link(**{component: value}), known)
    assert found.novelty[0] > 3 and SPACE[found.component[0]] == component


def test_mirror_images_are_not_taken_for_granted():
    """Thrown with ω > 0 alone: the networks know nothing of ω < 0. A ω of 2 lies 2.1 / 0.6 deviations from 0."""
    observation = rng(2).normal(size=(400, 6))
    observation[:, 5] = np.abs(observation[:, 5])
    known = thrown(observation, np.arange(400))
    there, mirrored = (novelty(one_link(a=1, y=0, angle=1.57, omega=sign * 2.0), known) for sign in (1, -1))
    assert mirrored.distance[0] > there.distance[0] + 0.5 and SPACE[mirrored.component[0]] == "omega"


def test_states_that_are_not_finite_have_no_distance(known):
    found = novelty(one_link(vx=np.nan), known)
    assert np.isnan(found.distance[0]) and np.isnan(found.novelty[0]) and found.component[0] == -1


def test_one_throw_has_distances_but_no_usual_one():
    known = thrown(rng().normal(size=(50, 6)), np.zeros(50, int))
    assert known.usual is None and known.reason.startswith("all states come from one throw")
    found = novelty(one_link(), known)
    assert np.isfinite(found.distance[0]) and np.isnan(found.novelty[0])


def test_throws_that_repeat_each_other_have_no_usual_distance():
    known = thrown(np.tile(rng().normal(size=(5, 6)), (4, 1)), np.repeat(np.arange(4), 5))
    assert known.usual is None and "repeat each other" in known.reason


def test_a_component_that_never_varied_makes_any_other_value_far():
    observation = rng().normal(size=(100, 6))
    observation[:, 2] = 0.5
    known = thrown(observation, np.arange(100))
    found = novelty(one_link(angle=1.0), known)
    assert found.novelty[0] > 1000 and SPACE[found.component[0]] == "cos_angle"


def test_rollouts_are_measured_link_by_link(study, known):
    links = link_states(study.designs, study.trace[:, :5], PHYSICS)
    found = novelty(links, known)
    assert found.novelty.shape == (6, 5, 6)
    one = LinkStates(**{name: array[2, 3, 4:5] for name, array in vars(links).items()})
    assert novelty(one, known).distance[0] == found.distance[2, 3, 4]


def test_observations_of_the_wrong_shape_are_refused():
    with pytest.raises(ValueError, match=r"observation has shape \(5, 3\), expected \(at least 1, 6\)"):
        thrown(np.zeros((5, 3)), np.zeros(5))
