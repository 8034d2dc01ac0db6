"""Errors of each member: by speed and immersion along rollouts, and as a phantom thrust at low speed.

The first needs the true medium. The second needs only throws that the members were not trained on, so it also serves
users whose true environment is not a simulation.
"""

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

COMPONENTS = ("vx", "vy", "omega")  # velocities that a medium changes [m/s, m/s, rad/s]

IMMERSIONS = ("all", "dry", "partly", "submerged")  # part of a link below the surface: any, none, some, all

_FULLY_SUBMERGED = 1 - 1e-6  # least area below the surface of a submerged link [m²], which has 1 m² up to rounding


@dataclass(frozen=True)
class MemberError:
    """One row of the table. Errors are predicted - true accelerations [m/s², m/s², rad/s²]; None if n_rows is 0."""

    member: int
    component: str  # one of COMPONENTS
    band: str  # speed band, one of BANDS [m/s]
    immersion: str  # one of IMMERSIONS
    n_rows: int  # link states in the band
    bias: float | None  # mean error
    rmse: float | None
    rms_true: float | None  # root mean square of the true acceleration, which is the error of predicting zero


def member_errors(
    ensemble: EnsembleMedium, medium: Medium, links: LinkStates, physics: Physics
) -> tuple[MemberError, ...]:
    """Return the errors of every member on link states; states that are not finite are left out.

    Args:
        ensemble: n_members members.
        medium: the true medium, such as Slush.
        links: link states of shape (...), such as those of champions.
        physics: the base simulator's constants.
    """
    true = acceleration(medium, links, physics).reshape(-1, 3)
    error = member_accelerations(ensemble, links, physics).reshape(ensemble.n_members, -1, 3) - true
    known = np.isfinite(true).all(axis=1) & np.isfinite(error).all(axis=(0, 2))
    speed = np.hypot(links.vx, links.vy).ravel()
    area, _ = submerged_part(links.length_scale, links.y, links.cos, links.sin)
    wet = area.ravel()
    immersed = {
        "all": known,
        "dry": wet <= 0,
        "partly": (wet > 0) & (wet < _FULLY_SUBMERGED),
        "submerged": wet >= _FULLY_SUBMERGED,
    }
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
    """Convert the states of throws to link states, (n_transitions,)."""
    a = transitions.length_scale.astype(np.float32)
    mass = np.full(len(a), physics.link_density, np.float32)  # every link has 1 m²
    _, y, angle, vx, vy, omega = transitions.state.T
    inertia = mass * (a * a + 1 / (a * a)) / 12
    return LinkStates(a, mass, inertia, y, np.cos(angle), np.sin(angle), vx, vy, omega)


def phantom_thrust(
    ensemble: EnsembleMedium, held_out: Transitions, physics: Physics, *, rng: Generator
) -> tuple[Estimate, ...]:
    """Return the horizontal acceleration [m/s²] that each member hallucinates at low speed; positive pushes towards +x.

    Slush does not push a link at rest to either side. So a mean error of vx at |v| < 0.5 m/s is a thrust that does not
    exist: a robot that merely floats in it is predicted to travel. The intervals come from resampling whole throws,
    because the steps of one throw resemble each other.

    Args:
        ensemble: n_members members.
        held_out: throws that the members were not trained on.
        physics: the base simulator's constants.
        rng: source of randomness.
    """
    _, low, high = next(band for band in BANDS if band[0] == LOW_SPEED)
    state = held_out.state
    speed = np.hypot(state[:, 3], state[:, 4])
    slow = (low <= speed) & (speed < high)
    if not slow.any():
        return (Estimate.missing(f"no held-out state with |v| {LOW_SPEED} m/s"),) * ensemble.n_members
    predicted = member_accelerations(ensemble, thrown_links(held_out, physics), physics)[:, slow, 0]
    true = held_out.residual[slow, 3].astype(np.float64) / physics.time_step
    _, throw = np.unique(held_out.throw[slow], return_inverse=True)
    errors = np.concatenate((predicted - true, np.ones((1, int(slow.sum())))))
    sums: Float64 = np.stack([np.bincount(throw, weights=row).astype(np.float64) for row in errors], axis=-1)
    return bootstrap(
        lambda means: means[..., :-1] / means[..., -1:], sums, rng=rng, undefined="a member's prediction is not finite"
    )
