import numpy as np

from tasks.residual import Architecture, Throws, Training, initial_states, simulate_throws
from tasks.residual.ensemble import Ensemble
from tasks.residual.training import train_member
from tasks.simulation.free_links import link_constants
from tasks.world import LinkStates, Physics, VelocityChange
from tasks.world.slush import submerged_part

BACK = 0.8


class HoldsBack:
    """Takes back a share of what strikes did to the part of a link that is under water."""

    def velocity_change(self, links, physics):
        area, second_moment = submerged_part(links.length_scale, links.y, links.cos, links.sin)
        J = second_moment * 12 / (links.length_scale**2 + links.length_scale**-2)
        return VelocityChange(
            *(-BACK * of for of in (area * links.kick_vx, area * links.kick_vy, J * links.kick_omega))
        )


def test_kicks_of_any_size_are_answered():
    """Of ten times the strikes that throws had."""
    settings = Throws(design="struck", n_throws=32, n_steps=40)
    starts = initial_states(settings, np.random.default_rng(1), Physics())
    training = Training(n_iterations=400, batch_size=256, learning_rate=0.02, decay="cosine", loss="mse")
    network = Architecture(hidden_layers=1, width=16, form="wetted_mass")
    member = train_member(simulate_throws(starts, 40, HoldsBack(), Physics()), network, training, seed=1, member=0)
    rng = np.random.default_rng(2)
    a, angle, kick = rng.uniform(1, 3, 200), rng.uniform(0, 6, 200), rng.uniform(-30, 30, (3, 200))
    state = [np.full(200, -5.0), np.cos(angle), np.sin(angle), *rng.uniform(-1, 1, (3, 200)), np.zeros(200), *kick]
    links = LinkStates(*(of.astype(np.float32)[None] for of in (*link_constants(a, Physics()), *state)))
    found = Ensemble.from_members([member.arrays()]).velocity_change(links, Physics())
    off = (np.stack((found.vx, found.vy, found.omega))[:, 0] + BACK * kick) / kick.std()
    assert np.sqrt(np.square(off).mean()) < 0.1
