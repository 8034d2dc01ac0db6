"""Whether a fluid remembers what a bar did before, which networks of a link's state cannot learn.

A fluid that is set in motion (added mass, a wake) pushes on a bar by what it did before, while residuals are learned
from the present state alone. Added mass that depends on the state alone, as that of a free bar far below the surface,
cannot be told from drag: the networks learn it, and are wrong where joints pull on a link.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from tasks.residual import MeasuredTransitions

_LAG = (6, 3.0)  # steps and frames, whichever is longer, over which the acceleration before a state is taken
_N_NEIGHBOURS = 12
_LEAST_ROWS = 500  # that the test of memory requires
_CLEAR = 0.25  # share of the residuals' deviation that their own uncertainty may be, for a row to be tested
_LEAST_MEMORY = 0.1  # share of the earlier acceleration that counts as an effect
_SD_OF_MEMORY = 5.0


@dataclass(frozen=True)
class Memory:
    """Dependence of residuals on the acceleration before the present state."""

    n_rows: int  # rows that are tested; 0 if the tracks are too few or too noisy
    share: float  # of the acceleration over the steps before, in the residual acceleration; 0 for a medium of states
    sd: float

    @property
    def found(self) -> bool:
        """Whether the effect is large and beyond chance."""
        return self.n_rows > 0 and abs(self.share) > max(_LEAST_MEMORY, _SD_OF_MEMORY * self.sd)


def memory(transitions: MeasuredTransitions, time_step: float, frame_interval: float) -> Memory:
    """Compare the residuals of bars in the same state that accelerated differently before it.

    Each row below the surface is compared with its nearest neighbours in other throws. Within such a neighbourhood the
    residual is regressed on the state and on the acceleration over the steps before; of a medium that acts by the state
    alone, the acceleration explains nothing. What happens within the typical interval between frames [s] is
    interpolated, so that the steps before reach over several.
    """
    lag = max(_LAG[0], round(_LAG[1] * frame_interval / time_step))
    row_of = {pair: row for row, pair in enumerate(zip(transitions.throw, transitions.step, strict=True))}
    previous = np.array([row_of.get((throw, step - lag), -1) for throw, step in row_of], dtype=np.int64)
    length = transitions.length_scale
    wet = transitions.state[:, 1] < -np.hypot(length, 1 / length) / 2
    spread = transitions.residual[wet, 3:5].std(axis=0) if wet.any() else np.zeros(2)
    clear = (transitions.residual_sd[:, 3:5] < _CLEAR * np.maximum(spread, 1e-12)).all(axis=1)
    rows = np.flatnonzero(wet & clear & (previous >= 0))
    if len(rows) < _LEAST_ROWS:
        return Memory(0, float("nan"), float("nan"))
    state, throw = transitions.state.astype(np.float64), transitions.throw[rows]
    before = (state[rows, 3:5] - state[previous[rows], 3:5]) / (lag * time_step)
    _, _, angle, vx, vy, omega = state[rows].T
    features = np.stack([length[rows], np.cos(angle), np.sin(angle), vx, vy, omega], axis=1)
    features /= np.maximum(features.std(axis=0), 1e-9)
    _, near = scipy.spatial.cKDTree(features).query(features, k=_N_NEIGHBOURS)
    residual = transitions.residual[rows, 3:5].astype(np.float64) / time_step
    slopes, weights = [], []
    for centre in range(0, len(rows), max(len(rows) // 2000, 1)):
        neighbours = near[centre]
        centred = [part[neighbours] - part[neighbours].mean(axis=0) for part in (features, before, residual)]
        explained, *_ = np.linalg.lstsq(centred[0][:, 3:], np.hstack(centred[1:]), rcond=None)
        left = np.hstack(centred[1:]) - centred[0][:, 3:] @ explained
        slopes.append(np.sum(left[:, :2] * left[:, 2:]))
        weights.append(np.sum(np.square(left[:, :2])))
    total = float(np.sum(weights))
    share = float(np.sum(slopes)) / max(total, 1e-12)
    n_throws = len(np.unique(throw))
    errors = np.array(slopes) - share * np.array(weights)
    sd = float(np.sqrt(np.sum(errors**2) * len(errors) / n_throws)) / max(total, 1e-12)
    return Memory(len(rows), share, sd)
