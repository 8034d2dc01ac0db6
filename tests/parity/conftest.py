"""Shared by the parity tests: fresh seeds, and a comparison with the platform's sine."""

import ctypes
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from tasks.simulation import free_links

PLATFORM = ctypes.CDLL(None)
for _name in ("sinf", "cosf"):
    getattr(PLATFORM, _name).argtypes, getattr(PLATFORM, _name).restype = [ctypes.c_float], ctypes.c_float

FUSED_SINE = (81.68215942382812, -116.23892974853516, 103.67251586914062, 81.67974090576172, 116.23892974853516)
FUSED_COSINE = (67.52783203125, 64.40264892578125, 32.72977828979492, -98.68684387207031, -17.278743743896484)
"""Angles at which sinf, or cosf, is another number where each product is rounded by itself. Of 300 million random ones
below 120 in absolute value, 214 are so: found by evaluating glibc's polynomials (see rotation.py) both ways."""

Pairs = list[tuple[np.ndarray, np.ndarray]]


def _sines(seed: int) -> Pairs:
    """Return pairs of our and the platform's sines, and cosines."""
    rng = np.random.default_rng(seed)
    exponent = rng.uniform(-20, 15, 20_000)
    angle = np.concatenate(
        [
            rng.uniform(-7, 7, 100_000),
            rng.uniform(-150, 150, 40_000),
            rng.choice([-1, 1], 20_000) * 2**exponent,
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
def sines() -> Callable[[int], Pairs]:
    return _sines


@pytest.fixture(scope="session")
def same_libm() -> None:
    """Skip unless the platform's sine is that of glibc with fused operations, as ours is."""
    for ours, theirs in _sines(0):
        if not np.array_equal(ours, theirs, equal_nan=True):
            n = int((ours != theirs).sum())
            pytest.skip(f"this platform's sinf or cosf differs from glibc's in {n} of {len(ours)} values")


@pytest.fixture
def seed() -> Iterator[int]:
    seed = int(np.random.SeedSequence().generate_state(1)[0])
    print(f"seed {seed}")  # pytest shows it if the test fails
    yield seed
