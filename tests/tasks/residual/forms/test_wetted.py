"""The wetted form: its law, its symmetries, and what it needs to learn a fluid."""

from dataclasses import fields, replace

import numpy as np
import pytest

from tasks.residual import Architecture, Throws, Training, initial_states, simulate_throws
from tasks.residual.current import current, is_current
from tasks.residual.ensemble import Ensemble
from tasks.residual.forms import observe, symmetric_copies, velocity_changes
from tasks.residual.forms.wetted import WETTED
from tasks.residual.torch_descent import row_losses
from tasks.residual.training import split_throws, train_member
from tasks.world import LinkStates, Physics, Slush, VelocityChange
from tasks.world.anisotropic_slush import AnisotropicSlush
from tasks.world.flowing_slush import FlowingSlush

TRAINING = Training(
    n_iterations=1000, batch_size=512, loss="mse", learning_rate=3e-2, min_learning_rate=3e-4, held_out=0.2
)
SIZE = {"hidden_layers": 2, "width": 16, "dropout": 0.0}


def links(n=500, seed=0, **fixed):
    """Random links across the waterline."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-9, 9, n)
    y, vx, vy, omega = rng.normal(size=(4, n))
    a = rng.uniform(1, 3, n)
    arrays = (a, np.ones(n), (a**2 + a**-2) / 12, y, np.cos(angle), np.sin(angle), vx, vy, omega)
    named = dict(zip((field.name for field in fields(LinkStates)), arrays, strict=False)) | fixed
    return LinkStates(**{name: np.broadcast_to(array, n).astype(np.float32) for name, array in named.items()})


def throws(n_throws, seed):
    starts = initial_states(Throws(design="robots", n_throws=n_throws, n_steps=None), np.random.default_rng(seed))
    return simulate_throws(starts, 100, Slush(), Physics())


@pytest.fixture(scope="module")
def trained():
    return train_member(throws(25, seed=1), Architecture(**SIZE, form="wetted"), TRAINING, seed=1, member=0)


def predicted(member, states):
    ensemble = Ensemble.from_members([member.arrays()])
    change = ensemble.velocity_change(LinkStates(**{k: v[None] for k, v in vars(states).items()}), Physics())
    return np.concatenate((change.vx, change.vy, change.omega)).T


@pytest.mark.parametrize(
    ("y", "cos", "sin", "expected"),
    [
        (-3, 1, 0, (2, 1 + 4, 3)),  # upright: t is up, n is to the right
        (-3, 0, 1, (-1, 2 + 4, 3)),  # lying: t is to the left, n is up
        (0, 0, 1, (-0.5, 3, 1.5)),  # half of it
        (3, 1, 0, (0, 0, 0)),
    ],
)
def test_outputs_act_along_the_link_s_axes_and_upwards_on_what_is_under_water(y, cos, sin, expected):
    inputs = observe(WETTED, links(1, y=y, cos=cos, sin=sin))
    assert velocity_changes(WETTED, np.float32([[1, 2, 3, 4]]), inputs)[0] == pytest.approx(expected, rel=1e-6)


def test_training_minimises_the_squared_error_of_that_law():
    rng = np.random.default_rng(3)
    inputs = observe(WETTED, links())
    true, outputs = rng.normal(size=(500, 3)), rng.normal(size=(500, 4))
    deviation = np.float32([2, 3, 4, 5])  # of the link's axes, in which squared errors are measured
    change = WETTED.measured(inputs, true) / deviation
    targets = WETTED.targets(inputs, change, np.full((500, 3), 0.5), deviation)
    error = WETTED.measured(inputs, velocity_changes(WETTED, outputs * deviation, inputs) - true) / deviation
    expected = 0.5 * np.square(error)[inputs[:, 0] > 0, :3].sum() / (3 * 500)
    assert row_losses(TRAINING, outputs, targets).mean() == pytest.approx(expected, rel=1e-5)
    assert 50 < (inputs[:, 0] == 0).sum() < 450


def test_copies_are_what_links_turned_by_half_a_turn_and_mirrored_links_observe():
    given = links()
    turned = replace(given, cos=-given.cos, sin=-given.sin)
    motions = given, turned, *(replace(x, sin=-x.sin, vx=-x.vx, omega=-x.omega) for x in (given, turned))
    inputs = [observe(WETTED, motion) for motion in motions]
    change = np.random.default_rng(4).normal(size=(500, 3)).astype(np.float32)
    changes = change, change, *[change * np.float32([-1, 1, -1])] * 2
    expected = [WETTED.measured(*motion) for motion in zip(inputs, changes, strict=True)]
    distinct = np.arange(1500, dtype=np.float32).reshape(500, 3)
    copies, copied, weights = symmetric_copies(WETTED, inputs[0], expected[0], distinct, mirrored=True)
    np.testing.assert_array_equal(copies, np.concatenate(inputs))
    np.testing.assert_array_equal(copied, np.concatenate(expected))
    np.testing.assert_array_equal(weights, np.tile(distinct, (4, 1)))


def test_a_dry_link_feels_nothing(trained):
    assert (predicted(trained, links(y=1.6)) == 0).all()
    assert (predicted(trained, links(y=-1.6)) != 0).all()


def test_a_few_throws_teach_it_what_plain_networks_do_not_learn_from_them(trained):
    plain = train_member(throws(25, seed=1), Architecture(**SIZE), TRAINING, seed=1, member=0)
    states = links(2000)
    change = Slush().velocity_change(states, Physics())
    true = np.stack((change.vx, change.vy, change.omega), axis=1)
    of_wetted, of_plain = (
        np.mean(np.square(predicted(member, states) - true).mean(axis=0) ** 0.5 / true.std(axis=0))
        for member in (trained, plain)
    )
    assert of_wetted < 0.3 and of_wetted < 0.4 * of_plain


def test_stored_weights_predict_what_was_validated(trained):
    data = throws(25, seed=1)
    held_out = data[split_throws(data.throw, TRAINING.held_out, seed=1)[1]]
    _, y, angle, vx, vy, omega = held_out.state.T
    a, cos, sin = held_out.length_scale, np.cos(angle), np.sin(angle)
    states = links(len(held_out), length_scale=a, y=y, cos=cos, sin=sin, vx=vx, vy=vy, omega=omega)
    rmse = np.sqrt(np.square(predicted(trained, states) - held_out.residual[:, 3:]).mean(axis=0))
    validated = [row.rmse for row in trained.validation if row.band == "all"]
    assert rmse == pytest.approx(validated, rel=1e-3)


class Wind:
    """It blows on what is in the air."""

    def velocity_change(self, links, physics):
        push = np.where(links.y > 0, 0.1, 0.0)
        return VelocityChange(push, 0 * push, 0 * push)


@pytest.mark.parametrize(
    ("medium", "acts"), [(Slush(), False), (FlowingSlush(), False), (AnisotropicSlush(), False), (Wind(), True)]
)
def test_media_that_act_above_the_water(medium, acts):
    assert bool(WETTED.objection(medium, Physics())) == acts


@pytest.mark.parametrize("design", ["paper", "robots"])
@pytest.mark.parametrize("flow", [0.0, 0.1, -3.0])
def test_the_flow_of_a_fluid_is_seen_in_throws(flow, design):
    throws = Throws(n_throws=50, design=design)
    starts = initial_states(throws, np.random.default_rng(3))
    thrown = simulate_throws(starts, 200, FlowingSlush(current=flow), Physics())
    found, sd = current(thrown)
    assert sd < 0.02 and abs(found - flow) < 4 * sd
    assert WETTED.warning(thrown).startswith(f"the fluid flows at {found:.2f}") == (flow != 0)
    assert is_current(found, sd) == (flow != 0)


def test_networks_learn_from_mirror_images_where_the_fluid_is_at_rest(monkeypatch):
    """Of a fluid that flows, mirror images would teach that it does not."""
    settings = Throws(design="robots", n_throws=25, n_steps=100)
    starts = initial_states(settings, np.random.default_rng(2))
    flowing, still = (simulate_throws(starts, 100, medium, Physics()) for medium in (FlowingSlush(), Slush()))
    training = Training(n_iterations=800, batch_size=512, learning_rate=0.02, loss="mse", held_out=0.3)
    network = Architecture(hidden_layers=2, width=32, form="wetted")

    def error(thrown):
        member = train_member(thrown, network, training, seed=1, member=0)
        (row,) = (row for row in member.validation if (row.component, row.band) == ("vx", "all"))
        return row.relative_error

    of_flowing, of_still = error(flowing), error(still)
    monkeypatch.setattr("tasks.residual.training.is_current", lambda flow, sd: False)
    assert error(flowing) > of_flowing
    monkeypatch.setattr("tasks.residual.training.is_current", lambda flow, sd: True)
    assert error(still) > of_still
