"""The throws that would teach a recorded study's networks most."""

from collections.abc import Iterator

import numpy as np

from pipeline.errors import PuddleError
from pipeline.results.recorded_study import Study
from pipeline.stages.collect import TRANSITIONS, read_transitions, throws_inputs
from pipeline.stages.data_sets import DataSetId
from pipeline.stages.pilot import STATES, PilotId
from pipeline.store.encoding import decode_table
from tasks.residual import suggest_throws
from tasks.residual.throws import Starts
from tasks.seeding import generator

MOST = 10_000  # throws that are suggested at once
_COLUMNS = ("length_m", "y_m", "angle_deg", "vx_m_s", "vy_m_s", "omega_rad_s")


def suggested_throws(study: Study, n: int, throws: str | None = None) -> Starts:
    """Suggest the starts of throws, those that fill holes in the data first.

    Args:
        study: the study; its first replicate is used.
        n: number of throws, at least 1.
        throws: settings group of the throws that were made; by default the study's main one.

    Returns:
        n starts.

    Raises:
        PuddleError: n is out of range, or the study has no such ensemble, no pilots or no throws.
    """
    if not 1 <= n <= MOST:
        raise PuddleError(f"--n: expected 1 to {MOST:,} throws, got {n:,}")
    from tasks.residual.ensemble import Ensemble  # imports torch

    ensemble = study.ensemble(throws=throws)
    assert isinstance(ensemble, Ensemble)
    data_set = DataSetId(throws or study.settings.throw_groups[0], 0)
    with study.store.lock_to_read():
        chunks = throws_inputs(study.upstream["collect"], data_set)
        transitions = read_transitions(
            [{TRANSITIONS: study.store.read(of.manifest, TRANSITIONS)} for of in chunks.values()]
        )
        (pilots,) = study.upstream["pilot"].chain(PilotId(data_set))
        states = decode_table(study.store.read(pilots, STATES), schema="states", version=1, source=STATES)
    rng = generator(study.settings.seed, "suggest throws", n)
    return suggest_throws(
        n, states["observation"], transitions.observation, ensemble, rng, physics=study.settings.physics
    )


def as_lines(starts: Starts) -> Iterator[str]:
    """Yield a table for the terminal."""
    heading = ("length [m]", "y [m]", "angle [°]", "vx [m/s]", "vy [m/s]", "ω [rad/s]")
    yield "throw" + "".join(f"{name:>12}" for name in heading)
    for number, (length, y, angle, vx, vy, omega) in enumerate(_rows(starts), start=1):
        yield f"{number:>5}{length:12.2f}{y:z12.2f}{angle:12.0f}{vx:z12.2f}{vy:z12.2f}{omega:z12.2f}"


def as_csv(starts: Starts) -> str:
    """Return the starts as comma-separated values."""
    rows = [",".join(f"{value:.4f}" for value in row) for row in _rows(starts)]
    return "\n".join([",".join(_COLUMNS), *rows, ""])


def _rows(starts: Starts) -> list[tuple[float, ...]]:
    """Return length [m], y [m], angle [degrees], vx, vy [m/s] and ω [rad/s] of each throw."""
    _, y, angle, vx, vy, omega = starts.state.astype(np.float64).T
    return list(
        zip(starts.length_scale.tolist(), *(of.tolist() for of in (y, np.degrees(angle), vx, vy, omega)), strict=True)
    )
