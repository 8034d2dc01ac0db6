"""Laws whose constants are fitted to throws."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tasks.design import random_designs
from tasks.residual import Architecture, Throws, Training, form_named, initial_states, simulate_throws
from tasks.residual.ensemble import Ensemble
from tasks.residual.forms import law
from tasks.residual.forms.law import UnfittedLaw, constants_of
from tasks.residual.training import train_member
from tasks.simulation import simulate
from tasks.world import ENVIRONMENTS, Physics, Pool, ResidualSlush, Slush
from tasks.world.anisotropic_slush import AnisotropicSlush
from tasks.world.falling_plate import FallingPlate
from tasks.world.medium import Fluid

TRAINING = Training(n_iterations=600, batch_size=256, learning_rate=0.02, loss="mse", held_out=0.25)


def throws(medium, n_throws=4, physics=None):
    physics = physics or Physics()
    settings = Throws(design="struck" if medium.reads_kicks else "robots", n_throws=n_throws, n_steps=100)
    return simulate_throws(initial_states(settings, np.random.default_rng(3), physics), 100, medium, physics)


def trained(transitions, form, member=0, physics=None):
    network = Architecture(hidden_layers=2, width=32, form=form)
    return train_member(transitions, network, TRAINING, seed=1, member=member, physics=physics)


def error(member):
    return np.mean([row.relative_error for row in member.validation if row.band == "all"])


@pytest.mark.parametrize("name", ["true_slush", "anisotropic_slush", "flowing_slush", "falling_plate"])
def test_a_few_throws_determine_the_constants_of_the_law_that_is_true(name):
    """Float32 residuals are right to 1e-7 of a velocity of 5 m/s, and a change in a step is 1e-2 m/s and more."""
    fluid, physics = ENVIRONMENTS[name].settings(), Physics(link_density=0.7, time_step=1 / 90, gravity=5.0)
    member = trained(throws(fluid, physics=physics), f"law:{name}", physics=physics)
    true = [getattr(fluid, constant) for constant in member.form.constants]
    assert member.law["constants"] == pytest.approx(true, rel=1e-4)
    assert member.law["factors"] == pytest.approx(fluid.factors(physics), rel=1e-4)
    assert error(member) < 1e-4


@pytest.mark.parametrize(
    ("name", "fluid"), [("true_slush", Slush()), ("falling_plate", FallingPlate(rotational_lift=3))]
)
def test_robots_move_in_a_law_that_is_true_as_in_its_fluid(name, fluid):
    members = [trained(throws(fluid), f"law:{name}", member).arrays() for member in range(2)]
    designs = random_designs(16, np.random.default_rng(4))
    fitted, true = ResidualSlush(2.0, Ensemble.from_members(members)), Pool(2.0, fluid)
    for engine in ("batch", "reference"):
        moved, expected = (simulate(designs, at, n_measure=200, engine=engine).displacement for at in (fitted, true))
        assert (moved == expected).all() and moved.shape == (2, 16)


def test_members_disagree_where_the_law_is_wrong():
    found = throws(AnisotropicSlush(), n_throws=8)
    of_members = np.array([trained(found, "law", member).law["constants"] for member in range(4)])
    assert (of_members.std(axis=0)[:2] > 0.01).all()
    of_members = np.array([trained(throws(Slush(), n_throws=8), "law", member).law["constants"] for member in range(4)])
    assert of_members == pytest.approx(np.tile([1.25, 10.0, 20.0], (4, 1)), rel=1e-4)


def test_networks_learn_what_the_law_leaves_over():
    found = throws(AnisotropicSlush(), n_throws=40)
    law, network, both = (error(trained(found, form)) for form in ("law", "wetted", "law_and_network"))
    assert both < network < law


class Treacle(Fluid):
    """A medium whose factor is not in proportion to a long time step."""

    decay: float = 5.0

    def factors(self, physics):
        return (math.expm1(-self.decay * physics.time_step),)

    @staticmethod
    def law(factors, links):
        return factors[0] * links.vx, factors[0] * links.vy, factors[0] * links.omega


def test_a_factor_that_is_nearly_in_proportion_to_the_time_step_follows_it(monkeypatch):
    kinds = {**ENVIRONMENTS, "treacle": SimpleNamespace(settings=Treacle, has_one_medium=True)}
    monkeypatch.setattr(law, "ENVIRONMENTS", kinds)
    assert form_named("law:treacle").factors_in_proportion == (True,)


@pytest.mark.parametrize("form", ["law:dry_land", "law:randomised_slush", "law:honey", "law_and_network:honey"])
def test_a_law_without_constants_is_refused(form):
    said = f"expected the law of a fluid with constants, any of true_slush, .*'{form.partition(':')[2]}'"
    with pytest.raises(ValueError, match=said):
        form_named(form)


def test_a_medium_with_a_change_of_its_own_has_no_constants():
    class Other(Slush):
        def velocity_change(self, links, physics):
            return super().velocity_change(links, physics)

    assert constants_of(Other) == {} and [*constants_of(Slush)] == ["density", "linear_drag", "angular_drag"]


def test_throws_that_do_not_touch_the_fluid_are_an_error_with_its_reason():
    found = throws(Slush())
    dry = found[found.state[:, 1] > 2.0]
    with pytest.raises(UnfittedLaw, match="density, linear_drag, angular_drag: expected throws that the constant"):
        trained(replace(dry, throw=np.arange(len(dry)) % 4), "law")
