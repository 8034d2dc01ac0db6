import numpy as np
import pytest

from tasks.residual import Architecture, Training
from tasks.residual.ensemble import Ensemble
from tasks.residual.forms import Targets
from tasks.residual.network import Standardisation, initial_weights
from tasks.residual.torch_descent import TorchDescent
from tasks.world import LinkStates, Physics

PHYSICS = Physics()
N_MEMBERS = 3
ARCHITECTURE = Architecture(hidden_layers=2, width=32)


def members(architecture, n_members=N_MEMBERS, seed=0):
    """Untrained networks, with the standardisation of data of different scales."""
    rng = np.random.default_rng(seed)
    networks, arrays = [], []
    for _ in range(n_members):
        rows = (rng.normal(size=(2, 100, 6)) * rng.uniform(0.1, 5, 6) + rng.normal(size=6)).astype(np.float32)
        standardisation = Standardisation.of(*rows, standardise_targets=True)
        weights = initial_weights(architecture.sizes, rng)
        targets = Targets(rows[1], rows[1][:, :0], rows[1][:, :0])
        networks.append(
            (TorchDescent([weights], [(rows[0], targets)], 0.0, Training(batch_size=1), [rng]), standardisation)
        )
        form = np.frombuffer(b"plain", np.uint8)
        arrays.append({**weights, **vars(standardisation), "form": form})
    return networks, arrays


def observations(n_rows, n_members=N_MEMBERS, seed=1):
    rng = np.random.default_rng(seed)
    return (rng.normal(size=(n_members, n_rows, 6)) * (0.7, 3, 0.6, 4, 4, 4)).astype(np.float32)


def links(shape):
    rng = np.random.default_rng(2)
    angle = rng.uniform(-9, 9, shape)
    a = rng.uniform(1, 3, shape)
    y, vx, vy, omega = rng.normal(size=(4, *shape))
    arrays = (a, np.ones(shape), (a**2 + a**-2) / 12, y, np.cos(angle), np.sin(angle), vx, vy, omega)
    return LinkStates(*(x.astype(np.float32) for x in arrays))


@pytest.fixture(scope="module")
def ensemble():
    return Ensemble.from_members(members(ARCHITECTURE)[1])


def test_an_ensemble_is_shown_without_its_weights(ensemble):
    assert repr(ensemble) == "Ensemble(3 plain networks of 6 → 32 → 32 → 3 units)"


@pytest.mark.parametrize("architecture", [Architecture(hidden_layers=1, width=7), Architecture(hidden_layers=3)])
def test_the_mean_of_an_ensemble_is_one_network(architecture):
    several = Ensemble.from_members(members(architecture)[1])
    x = np.broadcast_to(observations(50)[:1], (N_MEMBERS, 50, 6))
    expected = several.predict(np.ascontiguousarray(x)).mean(axis=0)
    np.testing.assert_allclose(several.mean().predict(x[:1].copy())[0], expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("architecture", [Architecture(hidden_layers=1, width=7), Architecture()])
def test_equals_each_member_s_own_network(architecture):
    networks, arrays = members(architecture)
    x = observations(300)
    got = Ensemble.from_members(arrays).predict(x)
    assert got.shape == (N_MEMBERS, 300, 3) and got.dtype == np.float32
    for k, (network, standardisation) in enumerate(networks):
        (standard,) = network.predict([standardisation.standard_observation(x[k])])
        expected = standardisation.residual(standard)[:, 3:]
        # Sums of n terms in two orders differ by about n^½ roundings, in each layer and in the folded standardisation.
        roundings = (architecture.hidden_layers + 1) * architecture.width**0.5
        assert np.abs(got[k] - expected).max() < 2 * roundings * 2**-24 * np.abs(expected).max()


@pytest.mark.parametrize(("hidden_layers", "width"), [(1, 7), (2, 32), (2, 64), (3, 64), (3, 100), (3, 128), (4, 256)])
def test_a_row_does_not_depend_on_the_rows_beside_it(hidden_layers, width):
    arrays = members(Architecture(hidden_layers=hidden_layers, width=width))[1]
    ensemble = Ensemble.from_members(arrays)
    x = observations(700)
    whole = ensemble.predict(x)
    seed = np.random.SeedSequence().entropy  # fresh each time; named if it fails
    rng = np.random.default_rng(seed)
    for n_rows in (1, 2, 5, 96, 127, 128, 129, 384, 699, *rng.integers(1, 700, 5)):
        rows = rng.permutation(700)[:n_rows]
        assert (ensemble.predict(np.ascontiguousarray(x[:, rows])) == whole[:, rows]).all(), (n_rows, seed)
    for k in range(N_MEMBERS):
        assert (Ensemble.from_members([arrays[k]]).predict(x[k : k + 1]) == whole[k : k + 1]).all()


def test_velocity_change_reads_the_links_in_order(ensemble):
    state = links((N_MEMBERS, 5, 6))
    change = ensemble.velocity_change(state, PHYSICS)
    observation = np.stack((state.length_scale, state.y, state.cos, state.vx, state.vy, state.omega), axis=-1)
    expected = ensemble.predict(observation.reshape(N_MEMBERS, 30, 6)).reshape(N_MEMBERS, 5, 6, 3)
    for i, name in enumerate(("vx", "vy", "omega")):
        got = getattr(change, name)
        assert got.shape == (N_MEMBERS, 5, 6) and got.dtype == np.float32
        assert (got == expected[..., i]).all()
