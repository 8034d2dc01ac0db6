import numpy as np
import pytest

from tasks.design import Designs, LinkLimits, Morphology, random_designs
from tasks.residual import STATE, Throws, Training, Transitions
from tasks.residual.robot_tracks import record
from tasks.residual.throws import throw
from tasks.residual.training import learn
from tasks.simulation import simulate
from tasks.simulation.engine import links_in
from tasks.world import DryLand, Physics, ResidualSlush, TrueSlush, VelocityChange, as_environment

PHYSICS = Physics()
STEPS = {"n_settle": 5, "n_measure": 60}


def _designs(n, n_links):
    morphology = Morphology(n_links=LinkLimits(least=n_links, most=n_links))
    return random_designs(n, np.random.default_rng(n_links), morphology=morphology)


@pytest.mark.parametrize("name", ["true_slush", "falling_plate"])  # without and with kicks
def test_the_residual_is_what_the_medium_changed(name):
    tracks, medium = record(_designs(3, 6), name, **STEPS), as_environment(name).medium
    change = medium.velocity_change(tracks.links(PHYSICS), PHYSICS)
    expected = np.stack((change.vx, change.vy, change.omega), axis=1)
    # Angles pass through an arctangent and back, which rounds by 2^-23, and velocities below 32 by 2^-20, in a law of
    # a few dozen operations.
    assert np.abs(tracks.state[:, 3:]).max() < 32
    assert np.abs(tracks.residual[:, 3:] - expected).max() < 40 * 2**-20
    assert (np.abs(tracks.residual[:, 3:]) > 0.1).any() and (np.abs(tracks.kick) > 0.1).any()
    dx = tracks.residual[:, :3] - PHYSICS.time_step * tracks.residual[:, 3:]
    assert np.abs(dx).max() < 4 * 2**-19  # positions below 64


def test_each_robot_is_one_throw_whose_states_are_those_of_its_rollout():
    designs = Designs.concatenate([_designs(2, 6), _designs(2, 3)])[[0, 2, 1, 3]]
    tracks = record(designs, "true_slush", depth=2.0, **STEPS)
    trace, n_steps = simulate(designs, TrueSlush(2.0), trace=True, **STEPS).trace, 65
    for robot, n_links in enumerate((6, 3, 6, 3)):
        own = tracks[tracks.throw == robot]
        assert len(own) == n_links * n_steps and (own.step[:n_steps] == range(n_steps)).all()
        states, after = own.state.reshape(n_links, n_steps, 6), trace[robot, :, :n_links].swapaxes(0, 1)
        np.testing.assert_array_equal(states[:, 1:, [0, 1, 3, 4, 5]], after[:, :-1, [0, 1, 3, 4, 5]])
        lengths = designs.length_scale[robot, :n_links].astype(np.float32)
        np.testing.assert_array_equal(own.length_scale[::n_steps], lengths)


def test_links_in_an_engines_own_fluid_step_as_thrown_bars_do():
    pytest.importorskip("mujoco")
    designs, fluid = _designs(2, 6), as_environment("mujoco_fluid")
    tracks = record(designs, fluid, **STEPS)
    trace = simulate(designs, fluid, trace=True, **STEPS).trace
    np.testing.assert_array_equal(tracks.state.reshape(2, 6, 64, 6), trace[:, :-1].swapaxes(1, 2).astype(np.float32))
    some = tracks[np.arange(5, len(tracks), 60)]
    np.testing.assert_array_equal(links_in(fluid.medium, some.length_scale, PHYSICS)(some.state), some.next_in_target)
    wet = tracks.state[:, 1] < -2
    assert (np.abs(tracks.residual[wet, 4]) > 0.1).all()  # buoyancy of 12.25 m/s² in a sixtieth of a second
    after, kick = (of.reshape(12, 64, -1) for of in (tracks.next_in_target[..., 3:], tracks.kick))
    assert not kick[:, 0].any() and (np.abs(kick) > 0.1).any()
    np.testing.assert_allclose(after[:, :-1] + kick[:, 1:], tracks.state.reshape(12, 64, 6)[:, 1:, 3:], atol=2**-18)


def test_a_robot_that_diverges_in_an_engines_own_fluid_leaves_others_as_they_are(monkeypatch):
    pytest.importorskip("mujoco")
    designs, fluid = _designs(2, 6), as_environment("mujoco_fluid")
    assert len(record(designs, fluid, n_settle=0, n_measure=1)) == 0
    tracks = record(designs, fluid, n_settle=0, n_measure=9)
    done = simulate(designs, fluid, n_settle=0, n_measure=9, trace=True)
    done.trace[1, 4:] = np.nan
    monkeypatch.setattr("tasks.residual.robot_tracks.simulate", lambda *_, **__: done)
    broken = record(designs, fluid, n_settle=0, n_measure=9)
    for name in ("state", "next_in_target", "kick"):
        of_each = [getattr(of, name)[of.throw == 0] for of in (tracks, broken)]
        np.testing.assert_array_equal(*of_each)
    assert (broken.step[broken.throw == 1] == np.tile(range(4), 6)).all()


def test_what_follows_a_divergence_is_left_out():
    class DiesBelow:
        def velocity_change(self, links, physics):
            nothing = np.zeros_like(links.y)
            return VelocityChange(np.where(links.y < -2, np.nan, 0).astype(np.float32), nothing, nothing)

    tracks = record(_designs(1, 6), DiesBelow(), n_settle=0, n_measure=200)
    assert 0 < len(tracks) < 6 * 200 and np.isfinite(tracks.residual).all()


def test_data_sets_are_joined_under_new_numbers():
    tracks = record(_designs(2, 6), "true_slush", n_settle=0, n_measure=3)
    joined = Transitions.of_several([tracks[tracks.throw == 1], tracks])
    assert joined.throw.tolist() == np.repeat([0, 1, 2], 18).tolist()
    np.testing.assert_array_equal(joined.state[18:], tracks.state)


def test_networks_learn_from_throws_and_tracks():
    """Of the same data they are the same, however it is given; what is held out is a whole robot."""
    throws = throw("true_slush", Throws(n_throws=4, n_steps=20))
    tracks = record(_designs(2, 6), "true_slush", n_settle=0, n_measure=20)
    quick = {"n_members": 1, "training": Training(n_iterations=20, batch_size=64)}
    both, joined, alone = (
        learn(data, **quick) for data in ([throws, tracks], Transitions.of_several([throws, tracks]), throws)
    )
    for first, same, other in zip(both.weights, joined.weights, alone.weights, strict=True):
        assert np.array_equal(first, same) and not np.array_equal(first, other)


def test_networks_know_the_time_step_they_learned_of():
    physics, quick = Physics(time_step=1 / 120), {"n_members": 2, "training": Training(n_iterations=10, batch_size=64)}
    throws = throw("true_slush", Throws(n_throws=4, n_steps=20), physics=physics)
    states = throws.columns() | dict(zip(STATE, throws.state.T, strict=True))
    learned = learn([throws, states], **quick, physics=physics)
    assert (learned.time_step, learned.mean().time_step) == (1 / 120, 1 / 120)
    assert learn(throws, **quick).time_step == 1 / 60


@pytest.mark.parametrize(
    ("throws", "n_members", "said"),
    [
        ([], 1, "expected at least one data set, got none"),
        ({**dict.fromkeys(STATE, (0.0, 1.0)), "throw": [0, 0], "length_scale": [1.0, 0.0]}, 1, "length_scale is 0 m"),
        ([], 0, "n_members is 0, expected at least 1"),
    ],
)
def test_what_nothing_can_be_learned_from_is_refused(throws, n_members, said):
    with pytest.raises(ValueError, match=said):
        learn(throws, n_members=n_members)


@pytest.mark.parametrize("environment", [DryLand(9.0), ResidualSlush(9.0, type("Two", (), {"n_members": 2})())])
def test_an_environment_without_one_medium_is_refused(environment):
    with pytest.raises(ValueError, match="expected one with one medium"):
        record(_designs(1, 6), environment)
