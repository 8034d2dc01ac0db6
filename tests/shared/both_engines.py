"""Shared by the tests of both engines: media that are not built in, unusual designs, and comparisons."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from tasks.design import Designs
from tasks.residual.ensemble import Ensemble
from tasks.residual.forms import Form
from tasks.residual.forms.plain import PLAIN
from tasks.simulation import batch, reference
from tasks.simulation.box2d import Motion
from tasks.world import Environment, LinkStates, Physics, Slush, VelocityChange

OTHER_CONSTANTS: dict[str, Any] = {
    "gravity": 3.7,
    "time_step": 0.0123,
    "velocity_iterations": 3,
    "position_iterations": 11,
    "link_density": 2.7,
    "friction": 0.31,
    "restitution": 0.45,
    "motor_gain": 3.0,
    "max_motor_torque": 31.0,
}
"""Every constant of the physics, none with the paper's value."""

STRONG_MOTORS: dict[str, Any] = {"max_motor_torque": 1e4, "motor_gain": 60.0}


class Slushes:
    """An ensemble of slushes of several densities, which compute in the given precision."""

    def __init__(self, *densities: float, precision: type[np.floating[Any]] = np.float32) -> None:
        self.n_members = len(densities)
        self._slushes = [Slush(density=density) for density in densities]
        self._precision = precision

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        each = []
        for k, slush in enumerate(self._slushes):
            member = LinkStates(**{name: array[k].astype(self._precision) for name, array in vars(links).items()})
            each.append(vars(slush.velocity_change(member, physics)))
        return VelocityChange(**{name: np.stack([change[name] for change in each]) for name in each[0]})


def networks(rng: np.random.Generator, form: Form = PLAIN) -> Ensemble:
    """Create three untrained networks with changes as large as the slush's."""
    sizes = (len(form.inputs) + len(form.unseen), 40, 40, len(form.outputs) + form.n_factors)
    weights = [(rng.normal(size=(3, a, b)) / np.sqrt(a)).astype(np.float32) for a, b in pairwise(sizes)]
    weights[-1] *= np.float32(0.05)
    biases = [(0.01 * rng.normal(size=(3, b))).astype(np.float32) for b in sizes[1:]]
    return Ensemble(weights=tuple(weights), biases=tuple(biases), form=form)


def wild(designs: Designs, rng: np.random.Generator, *, motor_on: float) -> Designs:
    """Return designs far beyond the paper's range: fast motors, large amplitudes, rest angles of many turns."""
    n = len(designs)
    return replace(
        designs,
        frequency=rng.uniform(0, 10, n),
        motion_range=rng.uniform(0, 40, (n, 6)),
        rest_angle=rng.uniform(-300, 300, (n, 6)),
        motor_on=rng.random((n, 6)) < motor_on,
    )


def golden_designs(*, motor_on: float) -> Designs:
    """Create eight designs from uniform numbers alone, independent of the rest of the code."""
    u = np.random.default_rng(20251121).random((8, 6, 8))
    child = np.arange(6) > 0
    return Designs(
        length_scale=1 + 2 * u[..., 0],
        parent=np.where(child, np.floor(u[..., 1] * np.arange(6)), -1).astype(int),
        parent_attachment=child * (2 * u[..., 2] - 1),
        child_attachment=child * (2 * u[..., 3] - 1),
        rest_angle=child * np.pi * (2 * u[..., 4] - 1),
        phase=child * 2 * np.pi * u[..., 5],
        motion_range=child * (0.2 + 1.3 * u[..., 6]),
        motor_on=child & (u[..., 7] < motor_on),
        frequency=0.3 * u[:, 0, 1],
    )


def golden_digest(environment: Environment, physics: Physics, *, motor_on: float) -> str:
    """Digest every float of a whole rollout of those designs in the batch engine."""
    designs = golden_designs(motor_on=motor_on)
    trace = batch.roll_out(designs, environment, physics, n_settle=200, n_measure=1200, trace=True).trace
    assert trace is not None
    return hashlib.sha256(np.ascontiguousarray(trace + 0.0, dtype="<f4").tobytes()).hexdigest()[:16]


def assert_equal(
    designs: Designs, environment: Environment, physics: Physics, *, n_settle: int, n_measure: int, trace: bool = True
) -> Motion:
    """Check that both engines agree in every float; return their motion."""
    duration = {"n_settle": n_settle, "n_measure": n_measure}
    ours, theirs = (
        engine.roll_out(designs, environment, physics, **duration, trace=trace, motor_work=True)
        for engine in (batch, reference)
    )
    for name in ("settled", "halfway", "final"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    alive = np.isfinite(ours.final).all(axis=(2, 3))
    assert ours.motor_work is not None and theirs.motor_work is not None
    np.testing.assert_array_equal(ours.motor_work[alive], theirs.motor_work[alive])
    assert (ours.trace is not None) == (theirs.trace is not None) == trace
    if ours.trace is not None:
        np.testing.assert_array_equal(ours.trace, theirs.trace)
    return ours


PLAIN_PYTHON = """
import numba, numpy as np
from tasks.design import random_designs
from tasks.simulation import batch, reference
from tasks.simd.lanes import widest
from tasks.world import DryLand, Physics, TrueSlush
assert numba.config.DISABLE_JIT
designs = random_designs({n_designs}, np.random.default_rng(0))
physics = Physics.model_validate_json({physics!r})
for environment, n_steps in zip((TrueSlush(0.02), DryLand(0.0)), {n_steps}, strict=True):
    ours = batch.roll_out(designs, environment, physics, n_settle=1, n_measure=n_steps, trace=True, n_lanes=widest())
    theirs = reference.roll_out(designs, environment, physics, n_settle=1, n_measure=n_steps, trace=True)
    assert np.array_equal(ours.trace, theirs.trace)
print("equal")
"""


def assert_equal_in_plain_python(n_designs: int, physics: Physics, n_steps: Sequence[int]) -> None:
    """Check that the kernels run in plain Python with the reference's bits, in slush and on dry land."""
    script = PLAIN_PYTHON.format(n_designs=n_designs, physics=physics.model_dump_json(), n_steps=tuple(n_steps))
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True)
    assert done.stdout == "equal\n", done.stderr
