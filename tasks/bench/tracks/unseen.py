"""How well a fitted medium predicts throws that it has not seen, and what its errors have in common."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tasks.residual import MeasuredTransitions
from tasks.residual.error_report import whole_throws
from tasks.simulation.free_links import FreeLinks
from tasks.world import Medium, Physics

_MATTERS = 0.1  # error of whole throws from which its causes are named
_PERSISTS = 0.7  # correlation of successive errors
_UNEVEN = 1.5  # factor between errors of two kinds


@dataclass(frozen=True)
class Unseen:
    """Errors on throws that are held out of a fit."""

    error: float  # where whole rollouts end, as a share of the way
    mirrored: float  # the same of the throws' mirror images
    depth: float  # errors of steps in the lower half of the water that was filmed, over those in the upper half
    persistence: float  # correlation of the errors of successive frames


def errors_on(throws: MeasuredTransitions, medium: Medium, physics: Physics, persistence: float) -> Unseen:
    """Follow throws from their starts in a medium that was not fitted to them."""
    off = (FreeLinks(throws.length_scale, physics).step(throws.state, medium) - throws.next_in_target)[:, 3:]
    squared, y = np.square(off / off.std(axis=0)).mean(axis=1), throws.state[:, 1]
    middle = np.median(y[y < 0]) if (y < 0).any() else np.nan
    deep, upper = y <= middle, (y > middle) & (y < 0)
    mirror = np.array((-1, 1, -1, -1, 1, -1), np.float32)
    mirrored = replace(throws, state=throws.state * mirror, next_in_target=throws.next_in_target * mirror)
    return Unseen(
        error=whole_throws(medium, throws, physics).relative_error,
        mirrored=whole_throws(medium, mirrored, physics).relative_error,
        depth=float(np.sqrt(squared[deep].mean() / squared[upper].mean())) if upper.any() else np.nan,
        persistence=persistence,
    )


def findings(folds: Sequence[Unseen]) -> list[str]:
    """Say what is wrong with a fluid, or with its tracks, that no error of a single step shows."""
    error, mirrored, depth, persistence = np.mean([list(vars(fold).values()) for fold in folds], axis=0)
    found = list[str]()
    if mirrored > max(_MATTERS, _UNEVEN * error):
        found.append(
            f"mirror images are predicted worse ({mirrored:.2f} and not {error:.2f} of the way): the fluid has none, "
            f"which wetted networks assume: network.form=signed_angle"
        )
    if error > _MATTERS and persistence > _PERSISTS:
        found.append(
            f"the last residual predicts the next (r = {persistence:.2f}): the fluid has memory, and networks that see "
            f"one instant do not; or it obeys a law that the fitted medium lacks"
        )
    if error > _MATTERS and (depth > _UNEVEN or depth < 1 / _UNEVEN):
        found.append(f"errors drift with depth: deep ones are {depth:.1f} times the others")
    return found
