"""Controllers: what is registered, and designs with genes of a controller's own."""

import re
from dataclasses import replace

import numpy as np
import pytest
from varied_designs import binomial_interval

from tasks.design import CONTROLLERS, DesignError, Designs, Mutation, check, crossover, mutate, random_designs
from tasks.design.controllers import Controller, gain, register_controller
from tasks.design.controllers.open_loop import swing as oscillator
from tasks.design.gait import reach, swing, top_speed

REFLEX, PHASE = (random_designs(200, np.random.default_rng(1), controller=name) for name in ("reflex", "phase"))


def second_harmonic(joint, sine):
    return oscillator(joint, sine) + joint.gains[0] * sine(2 * (joint.periods + joint.phase))


@pytest.fixture
def harmonic():
    register_controller(Controller("harmonic", second_harmonic, genes=(gain("second", 0.5, "rad"),)))
    yield "harmonic"
    del CONTROLLERS["harmonic"]


A = (gain("a", 1, ""),)
NOT_THREE = "failed: expected of each joint an angle, a number to remember and one to tell its parent's, got"


@pytest.mark.parametrize(
    ("controller", "said"),
    [
        (Controller("reflex", oscillator, A), "controller 'reflex' is registered twice"),
        (Controller("mine", oscillator), "controller 'mine': expected at least one gene of its own"),
        (Controller("mine", lambda joint, sine: joint.wet, A, ("spin",)), "reads wet, expected it among its senses"),
        (Controller("mine", lambda joint, sine: joint.weight, A), "its law reads weight, expected a field of Joint"),
        (Controller("mine", lambda joint, sine: joint.memory, A), "its law reads memory, expected remembers=True"),
        (Controller("mine", lambda joint, sine: 1.0 if joint.phase > 0 else 0.0, A), "law failed: The truth value of"),
        (Controller("mine", lambda joint, sine: (joint.phase,) * 2, A), "failed: expected of each joint an angle, got"),
        (Controller("mine", oscillator, A, remembers=True), NOT_THREE),
        (Controller("mine", lambda joint, sine: (joint.phase, joint.memory), A, remembers=True), NOT_THREE),
        (Controller("mi.ne", oscillator, A), "expected a name without dots"),
        (Controller("mine", oscillator, (*A, gain("a", 2, ""))), "genes that have different ones"),
        (Controller("mine", oscillator, (gain("a", np.inf, ""),)), "a: expected a gene of each joint, with finite"),
    ],
)
def test_what_can_not_be_a_controller_is_refused(controller, said):
    with pytest.raises(ValueError, match=said):
        register_controller(controller)


@pytest.mark.parametrize("designs", [REFLEX, PHASE], ids=["reflex", "phase"])
def test_designs_travel_by_the_names_of_their_genes(designs):
    arrays = dict(designs.arrays())
    assert [name for name in arrays if "." in name] == [gene.name for gene in CONTROLLERS[designs.controller].genes]
    assert Designs.from_arrays({**arrays, "fitness": np.zeros(200)}) == designs
    assert Designs.from_table(designs.table, designs.controller) == designs == designs[np.arange(200)]
    assert np.array_equal(Designs.from_vector(designs.to_vector(), designs.controller).parent, designs.parent)
    check(designs)


def test_half_of_random_gains_are_0_and_a_fifth_of_those_that_mutate_become_0():
    gains = REFLEX.gains[..., 1:]
    assert not REFLEX.gains[..., 0].any()  # the root has no joint
    low, high = binomial_interval(gains.size, 0.5)
    assert low <= (gains == 0).sum() <= high
    largest = np.array([gene.high for gene in CONTROLLERS["reflex"].genes])[:, None]
    positive = (gains > 0).sum() / (gains != 0).sum()
    assert abs(positive - 0.5) < 0.05 and 0.95 < (np.abs(gains) / largest).max() <= 1
    # 37 of 37 + 6 · 5 numbers change. A gain becomes 0 where |step| < 1/4 of its deviation: erf(1/4 / √2) = 0.1974.
    after = mutate(REFLEX, np.random.default_rng(2), mutation=Mutation(genes_changed=37.0)).gains[..., 1:]
    for before, became, share in ((gains != 0, after == 0, 37 / 67 * 0.1974), (gains == 0, after != 0, 37 / 67)):
        low, high = binomial_interval(before.sum(), share)
        assert low <= became[before].sum() <= high
    assert (np.abs(after) <= largest).all()


def test_three_genes_change_whatever_the_controller_has_and_gains_are_of_the_controller():
    changed = (mutate(REFLEX, np.random.default_rng(3)).table != REFLEX.table).sum(axis=1)
    assert 2.6 < changed.mean() < 3.6  # 3, some more where none was drawn, and rewiring
    adapted = mutate(REFLEX, np.random.default_rng(3), parts=("control",))
    assert (adapted.gains != REFLEX.gains).any()
    again = random_designs(9, np.random.default_rng(4), body=REFLEX[0], controller="reflex")
    assert (again.rest_angle == REFLEX.rest_angle[0]).all() and (again.gains != REFLEX.gains[0]).any()


def test_a_child_has_each_link_s_gains_from_the_parent_of_its_other_genes():
    one, other = REFLEX[:100], REFLEX[100:]
    child = crossover(one, other, np.random.default_rng(5))
    of_one = child.phase[:, 1:] == one.phase[:, 1:]
    chosen = np.where(of_one[:, None], one.gains[..., 1:], other.gains[..., 1:])
    np.testing.assert_array_equal(child.gains[..., 1:], chosen)
    assert of_one.any() and not of_one.all()


@pytest.mark.parametrize(
    ("mix", "said"),
    [
        (lambda: Designs.concatenate([REFLEX, PHASE]), "controllers phase, reflex, expected one of all designs"),
        (lambda: crossover(REFLEX, PHASE, np.random.default_rng(0)), "controllers reflex and phase, expected one"),
        (
            lambda: Designs.from_arrays({**dict(REFLEX.arrays()), "phase.load": REFLEX.phase}),
            "genes of the controllers phase and reflex, expected those of one",
        ),
        (
            lambda: Designs.from_table(REFLEX.table),
            "expected a table (n_designs, n_links · 8 + 1) float64, of 2 to 12 links, got (200, 85)",
        ),
        (lambda: random_designs(1, np.random.default_rng(0), controller="none"), "expected any of open_loop"),
        (lambda: replace(REFLEX, gains=PHASE.gains), "gains of reflex have shape (200, 2, 6), expected (200, 6, 6)"),
        (
            lambda: check(replace(REFLEX[:1], gains=np.full((1, 6, 6), np.nan))),
            "design 0: reflex.angle of link 1 is nan, expected -1 to 1",
        ),
    ],
)
def test_other_controllers_and_gains_are_refused_by_name(mix, said):
    with pytest.raises(DesignError, match=re.escape(said)):
        mix()


def test_a_gait_is_known_beforehand_where_nothing_is_sensed(harmonic):
    designs = random_designs(30, np.random.default_rng(6), controller=harmonic)
    periods = np.linspace(0, 1, 5001)[:, None, None]
    turns = 2 * np.pi * (periods + designs.phase / (2 * np.pi))
    expected = designs.motion_range * np.sin(turns) + designs.gains[:, 0] * np.sin(2 * turns)
    np.testing.assert_allclose(swing(designs, periods), expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(reach(designs), np.abs(expected).max(axis=0), rtol=1e-3)
    speed = np.abs(np.diff(expected, axis=0)).max(axis=0) * 5000 * designs.frequency[:, None]
    np.testing.assert_allclose(top_speed(designs), speed, rtol=2e-3)
    for designs, needs in ((REFLEX, "angle, speed, tilt, spin, wet, contact"), (PHASE, "angle, a memory")):
        with pytest.raises(DesignError, match=f"needs {needs}, which servos and checks of gaits lack"):
            swing(designs, periods)
