"""A medium of a user's own: what it returns fits the links, or an error names its file and line."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import puddle
from tasks.simulation.free_links import FreeLinks
from tasks.world import LinkStates, Physics, Pool, Slush, VelocityChange
from tasks.world.medium import MediumError, change_in

LINKS = LinkStates(*np.ones((9, 1, 2, 6), np.float32))
PHYSICS = Physics()


def medium_of(change):
    return type("Honey", (), {"velocity_change": lambda self, links, physics: change(links), "__module__": __name__})()


def test_numbers_are_of_all_links():
    change = change_in(medium_of(lambda links: VelocityChange(0.5, -links.vy, 0)), LINKS, Physics())
    assert [part.shape for part in (change.vx, change.vy, change.omega)] == [LINKS.y.shape] * 3
    assert (change.vx == 0.5).all() and change.vy.dtype == np.float32


NUMBERS = r"expected a number, or an array of numbers of the links' shape \(1, 2, 6\), got an array of "
EXPECTED = "TypeError: velocity_change: expected a VelocityChange, got"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda links: (links.vx, links.vy), f"{EXPECTED} tuple"),
        (lambda links: 0.0, f"{EXPECTED} float"),
        (lambda links: VelocityChange(links.z, 0, 0), "AttributeError: 'LinkStates' object has no attribute 'z'"),
        (lambda links: VelocityChange(np.zeros(5), 0, 0), rf"TypeError: vx: {NUMBERS}float64 and shape \(5,\)"),
        (
            lambda links: VelocityChange(0, links.vy[..., :1], 0),
            rf"TypeError: vy: {NUMBERS}float32 and shape \(1, 2, 1\)",
        ),
        (lambda links: VelocityChange(0, 0, "fast"), rf"TypeError: omega: {NUMBERS}<U4 and shape \(\)"),
    ],
    ids=["tuple", "number", "attribute", "shape", "shape that would do", "words"],
)
def test_anything_else_is_an_error_that_names_the_line(change, said):
    """That of the mistake, or of velocity_change where the medium itself did not fail."""
    code = change.__code__ if said.startswith("Attribute") else medium_of(change).velocity_change.__code__
    with pytest.raises(MediumError, match=f"^{__file__}:{code.co_firstlineno}: {said}"):
        change_in(medium_of(change), LINKS, Physics())


@pytest.mark.parametrize("engine", ["batch", "reference"])
@pytest.mark.parametrize("physics", [Physics(), Physics(link_collisions=True)], ids=["trees", "rigid bodies"])
def test_every_engine_says_so(engine, physics):
    design, home = puddle.random_designs(1, np.random.default_rng(0)), Pool(1.0, medium_of(lambda links: 0.0))
    with pytest.raises(MediumError, match="got float"):
        puddle.simulate(design, home, n_settle=0, n_measure=1, engine=engine, physics=physics)


def other_fluids():
    media = {}
    with pytest.MonkeyPatch.context() as briefly:
        briefly.setattr("tasks.world.registry.register_medium", lambda name, kind, _: media.setdefault(name, kind()))
        runpy.run_path(str(Path(__file__).parents[3] / "docs/results/other_fluids.py"))
    return media


def test_fluids_of_the_published_results_act_on_links_as_they_are_now():
    media = other_fluids()
    assert len(media) == 5
    for medium in media.values():
        assert np.isfinite(change_in(medium, LINKS, Physics()).vy).all()


def test_the_slush_after_the_solver_is_that_of_the_state_with_the_last_change():
    late = other_fluids()["late_slush"].start(LINKS, PHYSICS, 1.0)
    state = replace(LINKS, y=-LINKS.y)
    nothing, first, second = (late.velocity_change(state, PHYSICS) for _ in range(3))
    usual = Slush().velocity_change(state, PHYSICS)
    changed = replace(state, vx=state.vx + usual.vx, vy=state.vy + usual.vy, omega=state.omega + usual.omega)
    again = Slush().velocity_change(changed, PHYSICS)
    for name in ("vx", "vy", "omega"):
        assert not np.any(getattr(nothing, name)) and np.any(getattr(first, name) != getattr(second, name))
        np.testing.assert_array_equal(getattr(first, name), getattr(usual, name))
        np.testing.assert_array_equal(getattr(second, name), getattr(again, name))


def test_throws_say_so():
    with pytest.raises(MediumError, match="got float"):
        FreeLinks(np.ones(3), Physics()).step(np.zeros((3, 6), np.float32), medium_of(lambda links: 0.0))
