"""Fluids: a law gives the same bits in both engines, and what is no law is not taken for one."""

import numba
import numpy as np
import pytest
from both_engines import assert_equal

from tasks.design import random_designs
from tasks.simd.lanes import select
from tasks.simulation import batch
from tasks.simulation.fluids import is_compiled
from tasks.world import Fluid, LinkStates, Physics, Pool, Slush, VelocityChange


class Wind(Fluid):
    """A wind above the water, in this file."""

    def factors(self, physics: Physics) -> tuple[float, ...]:
        return (0.1 * physics.time_step,)

    @staticmethod
    def law(factors, links):
        still = 0.0 * links.vx
        return select(links.y > 0.0, factors[0] * (5.0 - links.vx), still), still, still


class Unfinished(Fluid):
    """A law that only NumPy can compute."""

    def factors(self, physics: Physics) -> tuple[float, ...]:
        return ()

    @staticmethod
    def law(factors, links):
        return np.where(links.y < 0, -links.vx, 0), links.vy, links.omega


class Still(Slush):
    """A subclass with a change of its own."""

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        return VelocityChange(0 * links.vx, 0 * links.vy, 0 * links.omega)


@pytest.mark.parametrize(
    "physics", [Physics(), Physics(passive_joints="locked", link_collisions=True)], ids=["trees", "rigid bodies"]
)
def test_both_engines_agree(physics):
    designs = random_designs(5, np.random.default_rng(4))
    assert_equal(designs, Pool(1.5, Wind()), physics, n_settle=20, n_measure=100)


def test_a_change_of_its_own_replaces_the_law():
    assert is_compiled(Slush()) and not is_compiled(Still()) and not is_compiled(None)
    designs = random_designs(3, np.random.default_rng(4))
    assert_equal(designs, Pool(1.5, Still()), Physics(), n_settle=5, n_measure=20)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="there is no compiler")
def test_a_law_that_does_not_compile_is_named_with_its_line():
    designs = random_designs(3, np.random.default_rng(4))
    line = Unfinished.law.__code__.co_firstlineno + 2
    with pytest.raises(ValueError, match=rf"test_fluids\.py:{line}: Unfinished\.law does not compile: expected op"):
        batch.roll_out(designs, Pool(1.0, Unfinished()), Physics(), n_settle=1, n_measure=3, trace=False)
