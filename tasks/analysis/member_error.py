"""How wrong each member is, and where: by speed and immersion along rollouts, and at rest as a phantom thrust.

The first needs the true medium. The second needs throws that a member was not trained on, and no more: it is there for
users whose true world is no simulation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from tasks.analysis.hallucination import acceleration, member_accelerations
from tasks.analysis.uncertainty import Estimate, bootstrap
from tasks.arrays import Float64
from tasks.residual import Transitions
from tasks.residual.error_report import BANDS, LOW_SPEED
from tasks.world import EnsembleMedium, LinkStates, Medium, Physics
from tasks.world.slush import submerged_part

COMPONENTS = ("vx", "vy", "omega")
"""Of what a medium changes; accelerations of them in m/s², m/s², rad/s²."""

IMMERSIONS = ("all", "dry", "partly", "submerged")
"""How much of a link is below the surface: anything, nothing, some, everything."""

WHOLE = 1 - 1e-6
"""Submerged area from which a link of 1 m² counts as submerged, rounding allowed for [m²]."""


@dataclass(frozen=True)
class MemberError:
    """A line of the table; None where there are no rows. Errors are predicted less true, as accelerations."""

    member: int
    component: str
    """Of COMPONENTS [m/s², m/s², rad/s²]."""
    band: str
    """Of speed, of BANDS [m/s]."""
    immersion: str
    """Of IMMERSIONS."""
    n_rows: int
    """Link states in the band."""
    bias: float | None
    """Mean error."""
    rmse: float | None
    """Root of the mean squared error."""
    rms_true: float | None
    """Root of the mean squared truth: the error of predicting nothing."""


def member_errors(
    ensemble: EnsembleMedium, medium: Medium, links: LinkStates, physics: Physics
) -> tuple[MemberError, ...]:
    """Compare every member with the true medium on link states of any one shape; those not finite are left out.

    Args:
        ensemble: n_members members.
        medium: the truth, such as Slush.
        links: where to compare, such as the states that champions pass through.
        physics: the base simulator's constants.
    """
    true = acceleration(medium, links, physics).reshape(-1, 3)
    error = member_accelerations(ensemble, links, physics).reshape(ensemble.n_members, -1, 3) - true
    known = np.isfinite(true).all(axis=1) & np.isfinite(error).all(axis=(0, 2))
    speed = np.hypot(links.vx, links.vy).ravel()
    area, _ = submerged_part(links.length_scale, links.y, links.cos, links.sin)
    wet = area.ravel()
    immersed = {"all": known, "dry": wet <= 0, "partly": (wet > 0) & (wet < WHOLE), "submerged": wet >= WHOLE}
    rows = []
    for band, low, high in BANDS:
        for immersion in IMMERSIONS:
            inside = known & (low <= speed) & (speed < high) & immersed[immersion]
            rows += _error_rows(error[:, inside], true[inside], band, immersion)
    return tuple(rows)


def _error_rows(error: Float64, true: Float64, band: str, immersion: str) -> list[MemberError]:
    n = len(true)
    if n == 0:
        empty = (band, immersion, 0, None, None, None)
        return [MemberError(k, component, *empty) for k in range(len(error)) for component in COMPONENTS]
    bias, rmse, rms_true = error.mean(axis=1), np.sqrt((error**2).mean(axis=1)), np.sqrt((true**2).mean(axis=0))
    return [
        MemberError(k, component, band, immersion, n, float(bias[k, i]), float(rmse[k, i]), float(rms_true[i]))
        for k in range(len(error))
        for i, component in enumerate(COMPONENTS)
    ]


def thrown_links(transitions: Transitions, physics: Physics) -> LinkStates:
    """Read the states of throws as links, (n_transitions,)."""
    a = transitions.length_scale.astype(np.float32)
    mass = np.full(len(a), physics.link_density, np.float32)  # every link has 1 m²
    _, y, angle, vx, vy, omega = transitions.state.T
    inertia = mass * (a * a + 1 / (a * a)) / 12
    return LinkStates(a, mass, inertia, y, np.cos(angle), np.sin(angle), vx, vy, omega)


def phantom_thrust(
    ensemble: EnsembleMedium, held_out: Transitions, physics: Physics, *, rng: Generator
) -> tuple[Estimate, ...]:
    """Estimate the horizontal acceleration that each member imagines at low speed [m/s²].

    Slush pushes nothing that is at rest to either side. A mean error of vx where |v| < 0.5 m/s is a thrust that does
    not exist, and robots that do nothing but float in it are predicted to travel. The intervals come from drawing
    throws whole, since the steps of one resemble each other.

    Args:
        ensemble: n_members members.
        held_out: throws that the members were not trained on.
        physics: the base simulator's constants.
        rng: source of randomness.

    Returns:
        One estimate a member; positive pushes towards +x.
    """
    _, low, high = next(band for band in BANDS if band[0] == LOW_SPEED)
    state = held_out.state
    speed = np.hypot(state[:, 3], state[:, 4])
    slow = (low <= speed) & (speed < high)
    if not slow.any():
        return (Estimate.missing(f"no held-out state with |v| {LOW_SPEED} m/s"),) * ensemble.n_members
    said = member_accelerations(ensemble, thrown_links(held_out, physics), physics)[:, slow, 0]
    true = held_out.residual[slow, 3].astype(np.float64) / physics.time_step
    _, throw = np.unique(held_out.throw[slow], return_inverse=True)
    errors = np.concatenate((said - true, np.ones((1, int(slow.sum())))))
    sums: Float64 = np.stack([np.bincount(throw, weights=row).astype(np.float64) for row in errors], axis=-1)
    return bootstrap(
        lambda means: means[..., :-1] / means[..., -1:], sums, rng=rng, undefined="a member's prediction is not finite"
    )
