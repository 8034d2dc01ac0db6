"""Both batch engines against pybox2d: every float of every step, with ==, on designs drawn anew each time."""

import ctypes
import itertools
from dataclasses import replace

import numba
import numpy as np
import pytest
from both_engines import OTHER_CONSTANTS, STRONG_MOTORS, Slushes, assert_equal, golden_digest, networks, wild
from links_in_box2d import ReferenceFreeLinks

from tasks.design import LinkLimits, Morphology, random_designs
from tasks.residual.forms import FORMS, form_named
from tasks.simd import rotation
from tasks.simd.lanes import widest
from tasks.simulation import batch, free_links
from tasks.simulation.box2d import Column
from tasks.world import DryLand, Environment, Medium, Physics, ResidualSlush, Slush, TrueSlush
from tasks.world.anisotropic_slush import AnisotropicSlush
from tasks.world.environment import Pool
from tasks.world.flowing_slush import FlowingSlush

ENGINES = {
    "trees": {},
    "rigid bodies, locked, colliding": {"passive_joints": "locked", "link_collisions": True},
    "rigid bodies, locked": {"passive_joints": "locked"},
    "rigid bodies, colliding": {"link_collisions": True},
}
ONE_OF_EACH = pytest.mark.parametrize("engine", [*ENGINES.values()][:2], ids=[*ENGINES][:2], indirect=True)
"""Where locks and collisions are nothing to what a test varies, which each engine meets in one place."""
AS_BUILT = Physics(passive_joints="locked", link_collisions=True, max_motor_torque=30.0)
N_DESIGNS = 9
"""Designs of each case, drawn anew in each run."""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(numba.config.DISABLE_JIT, reason="slow in Python; test_batch.py has a short one"),
]


PLATFORM = ctypes.CDLL(None)
for _name in ("sinf", "cosf"):
    getattr(PLATFORM, _name).argtypes, getattr(PLATFORM, _name).restype = [ctypes.c_float], ctypes.c_float

FUSED_SINE = (81.68215942382812, -116.23892974853516, 103.67251586914062, 81.67974090576172, 116.23892974853516)
FUSED_COSINE = (67.52783203125, 64.40264892578125, 32.72977828979492, -98.68684387207031, -17.278743743896484)
"""Angles at which sinf, or cosf, is another number where each product is rounded by itself. Of 300 million random ones
below 120 in absolute value, 214 are so: found by evaluating glibc's polynomials (see rotation.py) both ways."""


def sines(seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return pairs of our and the platform's sines, and cosines."""
    rng = np.random.default_rng(seed)
    angle = np.concatenate(
        [
            rng.uniform(-7, 7, 100_000),
            rng.uniform(-150, 150, 40_000),
            rng.choice([-1, 1], 20_000) * 2 ** rng.uniform(-20, 15, 20_000),
            np.arange(-400, 400) * np.pi / 4,
            FUSED_SINE,
            FUSED_COSINE,
            [0.0, -0.0, 120.0, -120.0, np.nextafter(np.float32(120), 0), np.inf, -np.inf, np.nan],
        ]
    ).astype(np.float32)
    each = angle.tolist()
    theirs = np.float32([PLATFORM.sinf(a) for a in each]), np.float32([PLATFORM.cosf(a) for a in each])
    return list(zip(free_links.sines_and_cosines(angle), theirs, strict=True))


@pytest.fixture(scope="session")
def same_libm() -> None:
    """Skip unless the platform's sine is that of glibc with fused operations, as ours is."""
    for ours, theirs in sines(0):
        if not np.array_equal(ours, theirs, equal_nan=True):
            n = int((ours != theirs).sum())
            pytest.skip(f"this platform's sinf or cosf differs from glibc's in {n} of {len(ours)} values")


@pytest.fixture
def seed() -> int:
    seed = int(np.random.SeedSequence().generate_state(1)[0])
    print(f"seed {seed}")  # pytest shows it if the test fails
    return seed


@pytest.fixture(params=ENGINES.values(), ids=ENGINES)
def engine(request) -> dict:
    """Physics that one of the engines computes."""
    return request.param


def test_sines_and_cosines_are_the_platform_s(same_libm: None, seed: int) -> None:
    for ours, theirs in sines(seed):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize(
    ("kind", "depth"), [(DryLand, 0.0), (DryLand, 2.0), (TrueSlush, 0.0), (TrueSlush, 0.3), (TrueSlush, 9.0)]
)
def test_every_float_of_every_step(kind, depth: float, engine, same_libm: None, seed: int) -> None:
    # Links of most random designs overlap at the spawn and push each other apart, if links collide.
    n_settle, n_measure = (20, 180) if engine else (200, 600)
    designs = random_designs(N_DESIGNS, np.random.default_rng(seed))
    motion = assert_equal(designs, kind(depth), Physics(**engine), n_settle=n_settle, n_measure=n_measure)
    assert np.isfinite(motion.final).all()


@ONE_OF_EACH
@pytest.mark.parametrize("environment", [DryLand(0.0), TrueSlush(1.0)], ids=["dry", "slush"])
@pytest.mark.parametrize("controller", ["open_loop", "reflex", "phase"])
@pytest.mark.parametrize("n_links", [2, 12])
def test_robots_of_other_numbers_of_links(
    n_links: int, controller: str, environment: Environment, engine, same_libm: None, seed: int
) -> None:
    number = Morphology(n_links=LinkLimits(least=n_links, most=n_links))
    designs = random_designs(N_DESIGNS, np.random.default_rng(seed), morphology=number, controller=controller)
    motion = assert_equal(designs, environment, Physics(**engine), n_settle=20, n_measure=130)
    assert motion.final.shape == (1, N_DESIGNS, n_links, 6) and np.isfinite(motion.final).all()


@pytest.mark.parametrize("environment", [DryLand(0.0), TrueSlush(0.3)], ids=["dry", "slush"])
@pytest.mark.parametrize("controller", ["reflex", "phase"])
def test_controllers_that_sense(controller: str, environment: Environment, engine, same_libm: None, seed: int) -> None:
    rng = np.random.default_rng(seed)
    designs, blind = (random_designs(N_DESIGNS, rng, controller=name) for name in (controller, "open_loop"))
    motion = assert_equal(designs, environment, Physics(**engine), n_settle=20, n_measure=280)
    assert np.isfinite(motion.final).all()
    same = replace(designs, controller="open_loop", gains=blind.gains)
    usual = batch.roll_out(same, environment, Physics(**engine), n_settle=20, n_measure=280, trace=False)
    feels = (designs.motor_on & (designs.gains[:, 0] != 0)).any(axis=1)  # the joint's angle, or its load
    differs = (motion.final != usual.final).any(axis=(0, 2, 3))[feels]
    jams = "link_collisions" in engine  # where links jam, feeling may change nothing
    assert differs.any() and (differs.all() or jams)


@pytest.mark.parametrize("environment", [DryLand(0.0), TrueSlush(1.0)], ids=["dry", "slush"])
def test_ends_of_groups_that_are_stepped_together(environment: Environment, same_libm: None, seed: int) -> None:
    """Without a trace, as in a study, two groups are stepped together; the last has unused lanes."""
    designs = random_designs(2 * widest() + 5, np.random.default_rng(seed))
    assert_equal(designs, environment, Physics(), n_settle=200, n_measure=400, trace=False)


@pytest.mark.parametrize("environment", [DryLand(0.0), TrueSlush(0.3), TrueSlush(2.0)], ids=str)
def test_robots_that_can_be_built(environment: Environment, same_libm: None, seed: int) -> None:
    morphology = Morphology(n_actuated=2, unjoined_links="apart")
    designs = random_designs(N_DESIGNS, np.random.default_rng(seed), morphology=morphology)
    motion = assert_equal(designs, environment, AS_BUILT, n_settle=20, n_measure=580)
    ghosts = AS_BUILT.model_copy(update={"link_collisions": False})
    through_one_another = batch.roll_out(designs, environment, ghosts, n_settle=20, n_measure=580, trace=False)
    assert (motion.final != through_one_another.final).any()  # links did collide


@pytest.mark.parametrize(("kind", "depth"), [(DryLand, 0.0), (TrueSlush, 2.0)])
def test_motors_far_beyond_the_paper_s_range(kind, depth: float, engine, same_libm: None, seed: int) -> None:
    rng = np.random.default_rng(seed)
    designs = wild(random_designs(N_DESIGNS, rng), rng, motor_on=0.9)
    motion = assert_equal(designs, kind(depth), Physics(**engine, **STRONG_MOTORS), n_settle=100, n_measure=500)
    assert abs(motion.final[..., Column.ANGLE]).max() > rotation.NEAR  # so that the other reduction of angles is met


@pytest.mark.parametrize("changed", [OTHER_CONSTANTS, {"max_motor_speed": 0.4}], ids=["all constants", "slow motors"])
def test_other_physics(changed, engine, same_libm: None, seed: int) -> None:
    designs, environment = random_designs(N_DESIGNS, np.random.default_rng(seed)), TrueSlush(0.3)
    motion = assert_equal(designs, environment, Physics(**engine, **changed), n_settle=60, n_measure=280)
    usual = batch.roll_out(designs, environment, Physics(**engine), n_settle=60, n_measure=280, trace=False)
    assert (motion.final != usual.final).any(axis=(0, 2, 3)).mean() > 0.5


@pytest.mark.parametrize("depth", [0.3, 9.0])
def test_drag_by_component(depth: float, engine, same_libm: None, seed: int) -> None:
    slush = Slush(drag="by_component")
    designs, environment = random_designs(N_DESIGNS, np.random.default_rng(seed)), TrueSlush(depth, slush)
    motion = assert_equal(designs, environment, Physics(**engine), n_settle=60, n_measure=240)
    usual = batch.roll_out(designs, TrueSlush(depth), Physics(**engine), n_settle=60, n_measure=240, trace=False)
    assert (motion.final != usual.final).any(axis=(0, 2, 3)).mean() > 0.8


@pytest.mark.parametrize(
    ("environment", "physics"),
    [(TrueSlush(0.5), Physics()), (TrueSlush(0.5), Physics(link_collisions=True)), (DryLand(0.0), AS_BUILT)],
    ids=["trees", "rigid bodies, colliding", "as built"],
)
def test_every_tree(environment: Environment, physics: Physics, same_libm: None, seed: int) -> None:
    trees = np.array(list(itertools.product((-1,), *(range(link) for link in range(1, 6)))))
    designs = replace(random_designs(len(trees), np.random.default_rng(seed)), parent=trees)
    assert_equal(designs, environment, physics, n_settle=20, n_measure=60)


@ONE_OF_EACH
@pytest.mark.parametrize(
    "environment",
    [
        Pool(0.3, AnisotropicSlush()),
        Pool(2.5, FlowingSlush()),
        ResidualSlush(0.3, Slushes(1.25, 0.6)),
        ResidualSlush(2.5, Slushes(1.25, 0.6, precision=np.float64)),
    ],
    ids=lambda environment: f"{type(environment.medium).__name__} {environment.depth}",
)
def test_media_that_kernels_do_not_have(environment: Environment, engine, same_libm: None, seed: int) -> None:
    designs = random_designs(N_DESIGNS, np.random.default_rng(seed))
    motion = assert_equal(designs, environment, Physics(**engine), n_settle=20, n_measure=180)
    assert np.isfinite(motion.final).all() and motion.trace.shape == (environment.n_members, N_DESIGNS, 200, 6, 6)


@ONE_OF_EACH
@pytest.mark.parametrize("trace", [True, False])
@pytest.mark.parametrize(
    ("form", "depth"),
    [*((name, 0.7) for name in (*sorted(FORMS), "law:flowing_slush", "law_and_network")), ("wetted", 4.0)],
)
def test_residual_slush_of_networks(form, depth: float, trace: bool, engine, same_libm: None, seed: int) -> None:
    """Without a trace, networks and engine are one kernel, whose vectors of 33 designs are partly those of both."""
    rng = np.random.default_rng(seed)
    designs = random_designs(N_DESIGNS if trace else 33, rng)
    environment = ResidualSlush(depth, networks(rng, form_named(form)))
    assert_equal(designs, environment, Physics(**engine), n_settle=20, n_measure=100, trace=trace)


@pytest.mark.parametrize("speed", [20.0, 200.0])
@pytest.mark.parametrize(
    "medium", [None, Slush(), AnisotropicSlush(), FlowingSlush()], ids=["dry", "slush", "anisotropic", "flowing"]
)
def test_throws(speed: float, medium: Medium | None, same_libm: None, seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 103
    length_scale = rng.choice([1.0, 2.0, 3.0, 1.7], n)
    state = rng.uniform(-1, 1, (n, 6)) * (0.2, 6, np.pi, speed, speed, speed)
    state = theirs = state.astype(np.float32)
    our_links = free_links.FreeLinks(length_scale, Physics())
    their_links = ReferenceFreeLinks(length_scale, Physics())
    for _ in range(100):
        state, theirs = our_links.step(state, medium), their_links.step(theirs, medium)
        np.testing.assert_array_equal(state, theirs)


@pytest.mark.parametrize(
    ("physics", "motor_on", "digests"),
    [
        (Physics(), 0.7, ("c138169907dfda72", "d94970aaba544355", "24271ddac0c048bf")),
        (AS_BUILT, 0.5, ("7c93bc2fa22a46ee", "1e9bcaa9723a8311", "e31ac06a40e7f445")),
    ],
    ids=["trees", "rigid bodies"],
)
def test_traces_are_those_of_every_other_platform_and_compiler(physics: Physics, motor_on: float, digests) -> None:
    environments = (DryLand(0.0), TrueSlush(1.0), TrueSlush(9.0))
    assert tuple(golden_digest(environment, physics, motor_on=motor_on) for environment in environments) == digests
