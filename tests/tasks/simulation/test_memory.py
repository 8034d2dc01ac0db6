"""Media with memory: one for each rollout, links in the designs' order, and kicks as both engines give them."""

import numba
import numpy as np
import pytest
from both_engines import assert_equal

import puddle
from tasks.design import random_designs
from tasks.residual.throws import Throws, initial_states, simulate_throws
from tasks.world import LinkStates, Physics, Pool, VelocityChange
from tasks.world.medium import MediumError
from tasks.world.slush import Slush, slush_change

DESIGNS = random_designs(5, np.random.default_rng(4))


class Wake:
    """Water that a robot's links drag along together: all feel its speed, and the share of the last kicks it kept."""

    def start(self, links: LinkStates, physics: Physics, depth: float) -> "MovingWake":
        return MovingWake(links, depth)


class MovingWake:
    def __init__(self, links: LinkStates, depth: float) -> None:
        self.speed, self.origin, self.depth = np.zeros_like(links.x[..., :1]), links.x.copy(), depth
        self.asked: list[LinkStates] = []

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        self.asked.append(links)
        wet = (links.y < 0) * np.float32(physics.time_step)
        taken = wet * (links.vx - self.speed) + wet * links.kick_vx + 0.01 * wet * (links.x - self.origin)
        self.speed = self.speed + np.float32(0.1) * taken.sum(axis=-1, keepdims=True, dtype=np.float32)
        rises = wet * np.where(links.parent < 0, 9, 11)
        return VelocityChange(-taken, rises - wet * links.vy, -wet * (links.omega + links.kick_omega))


class Kept(Wake):
    """It shows what its medium is asked."""

    def start(self, links: LinkStates, physics: Physics, depth: float) -> MovingWake:
        self.started = super().start(links, physics, depth)
        self.first = getattr(self, "first", self.started)
        return self.started


either_engine = pytest.mark.parametrize(
    "physics", [Physics(), Physics(passive_joints="locked", link_collisions=True)], ids=["trees", "rigid bodies"]
)


@either_engine
def test_both_engines_agree(physics):
    """Sums over links have the same bits, so a medium sees them in one order."""
    assert_equal(DESIGNS, Pool(1.0, Wake()), physics, n_settle=20, n_measure=100)


def test_a_rollout_depends_on_its_design_alone():
    home, duration = Pool(1.0, Wake()), {"n_settle": 5, "n_measure": 60, "trace": True}
    together = puddle.simulate(DESIGNS, home, **duration).trace
    for k in (3, 0, 3):
        np.testing.assert_array_equal(puddle.simulate(DESIGNS[k : k + 1], home, **duration).trace[0], together[k])


@pytest.mark.parametrize("engine", ["batch", "reference", "mujoco"])
def test_a_kick_is_what_joints_do(engine):
    """In the air they conserve momentum; in MuJoCo, which steps the angles of joints, to first order in the step."""
    most = 0.1 if engine == "mujoco" else 2e-4  # share of the greatest kick
    if engine == "mujoco":
        pytest.importorskip("mujoco")
    medium = Kept()
    puddle.simulate(DESIGNS, Pool(9.0, medium), n_settle=0, n_measure=12, engine=engine)
    first, *later = medium.first.asked
    assert medium.first.depth == 9.0 and not np.any([first.kick_vx, first.kick_vy, first.kick_omega])
    np.testing.assert_array_equal(first.parent[0], DESIGNS.parent)
    kick = np.array([(links.mass * links.kick_vx, links.mass * links.kick_vy) for links in later])
    assert np.abs(kick).max() > 0.1 and np.abs(kick.sum(axis=-1)).max() < most * np.abs(kick).max()


def test_throws_are_alone_and_meet_no_ground():
    medium, physics = Kept(), Physics()
    starts = initial_states(Throws(n_throws=6, n_steps=20), np.random.default_rng(1), physics)
    together = simulate_throws(starts, 20, medium, physics)
    assert medium.first.depth == np.inf and medium.first.asked[0].x.shape == (1, 6, 1)
    assert not np.any([links.kick_vx for links in medium.first.asked])
    parts = [simulate_throws(starts[k : k + 2], 20, medium, physics) for k in (4, 0, 2)]
    np.testing.assert_array_equal(together.next_in_target[:40], parts[1].next_in_target)
    np.testing.assert_array_equal(together.next_in_target[80:], parts[0].next_in_target)


class Added(Slush):
    """Slush that takes back half of each kick, by a law that engines compile."""

    reads_kicks = True

    @staticmethod
    def law(factors, links):
        vx, vy, omega = slush_change(factors, links, links.vx)
        return vx - 0.5 * links.kick_vx, vy - 0.5 * links.kick_vy, omega - 0.5 * links.kick_omega + 1e-4 * links.x


class Undeclared(Added):
    reads_kicks = False


@either_engine
def test_a_compiled_law_reads_kicks(physics):
    assert_equal(DESIGNS, Pool(1.0, Added()), physics, n_settle=20, n_measure=100)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="there is no compiler")
def test_a_law_that_reads_kicks_says_so():
    with pytest.raises(MediumError, match=r"test_memory\.py:\d+: Added\.law does not compile"):
        puddle.simulate(DESIGNS, Pool(1.0, Undeclared()), n_settle=0, n_measure=2)


class Starting:
    """A function makes the medium of a rollout."""

    def __init__(self, start):
        self.start = start


class Counting:
    """It remembers without a start."""

    def __init__(self, change=1.0):
        self.change = change

    def velocity_change(self, links, physics):
        self.change += 1.0
        return VelocityChange(self.change, 0.0, 0.0)


SHARED = Counting()


@pytest.mark.parametrize(
    ("medium", "said"),
    [
        (Counting(), "vx: expected the same change when asked twice"),
        (Starting(lambda *_: SHARED), "vx: expected the same change when asked twice"),
        (Counting(np.nan), "vx: expected finite numbers in the first step, got nan or inf"),
        (Counting(np.inf), "vx: expected finite numbers in the first step, got nan or inf"),
        (Starting(lambda links, physics, depth: depth), "start: expected a medium with velocity_change, got float"),
        (Starting(lambda links, *_: links.depth), "AttributeError: 'LinkStates' object has no attribute 'depth'"),
    ],
    ids=["no start", "shared memory", "nan", "inf", "no medium", "start fails"],
)
def test_a_medium_that_is_none_is_one_line(medium, said):
    with pytest.raises(MediumError, match=rf"^{__file__}:\d+: .*{said}"):
        puddle.simulate(DESIGNS, Pool(1.0, medium), n_settle=0, n_measure=2)


def test_a_medium_that_fails_later_is_a_status():
    class Late(MovingWake):
        def velocity_change(self, links, physics):
            change = super().velocity_change(links, physics)
            change.vx[0, 2] *= np.nan if len(self.asked) > 50 else 1.0
            return change

    medium = Starting(lambda links, physics, depth: Late(links, depth))
    status = puddle.simulate(DESIGNS, Pool(1.0, medium), n_settle=0, n_measure=100).status
    assert list(status) == ["ok", "ok", "diverged", "ok", "ok"]
