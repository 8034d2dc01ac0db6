"""Throws that fill the holes in what a recorded study's networks learned from."""

from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from string import Template

import numpy as np

from pipeline.errors import PuddleError
from pipeline.report.moving import document
from pipeline.results.recorded_study import Study
from pipeline.stages.collect import TRANSITIONS, read_transitions, throws_inputs
from pipeline.stages.data_sets import DataSetId
from pipeline.stages.pilot import STATES, PilotId
from pipeline.store.encoding import decode_table
from tasks.residual import suggest_throws
from tasks.residual.suggestion import ThrowLimits
from tasks.residual.throws import Starts
from tasks.seeding import generator
from tasks.world import froude_time

MOST = 10_000  # throws that are suggested at once
_COLUMNS = ("length_m", "y_m", "angle_deg", "vx_m_s", "vy_m_s", "omega_rad_s")
_HEADINGS = ("length [m]", "y [m]", "angle [°]", "vx [m/s]", "vy [m/s]", "ω [rad/s]")
_BENCH_HEADINGS = ("bar [mm]", "y [mm]", "angle [°]", "vx [m/s]", "vy [m/s]", "turns/s")


@dataclass(frozen=True)
class TankScale:
    """Units of starts: those of the simulation, or of a bench by Froude's law."""

    scale: float = 1.0  # bench metres per simulated metre

    @property
    def time(self) -> float:
        """Bench seconds per simulated second."""
        return froude_time(self.scale)

    @property
    def speed(self) -> float:
        """Bench speed per simulated speed."""
        return self.scale / self.time


SIMULATION = TankScale()


def suggested_throws(study: Study, n: int, throws: str | None = None, limits: ThrowLimits | None = None) -> Starts:
    """Suggest the starts of throws, those that cover the range of robots first.

    Args:
        study: the study; its first replicate is used.
        n: number of throws, at least 1.
        throws: settings group of the throws that were made; by default the study's main one.
        limits: what can be thrown; by default anything.

    Returns:
        n starts.

    Raises:
        PuddleError: n, the heights or the bars are out of range, or the study has no such ensemble.
        MissingInputs: throws, networks or pilots of the study are not done.
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
            [{TRANSITIONS: study.store.read(chunk.manifest, TRANSITIONS)} for chunk in chunks.values()]
        )
        (pilots,) = study.upstream["pilot"].chain(PilotId(data_set))
        states = decode_table(study.store.read(pilots, STATES), schema="states", version=1, source=STATES)
    rng = generator(study.settings.seed, "suggest throws", n)
    physics = study.settings.physics
    try:
        return suggest_throws(
            n, states["observation"], transitions.observation, ensemble, rng, physics=physics, limits=limits
        )
    except ValueError as error:
        raise PuddleError(f"{error} (in units of the simulation)") from None


def as_lines(starts: Starts, bench: TankScale = SIMULATION) -> Iterator[str]:
    """Yield a table for the terminal."""
    headings = _HEADINGS if bench == SIMULATION else _BENCH_HEADINGS
    yield "throw" + "".join(f"{name:>12}" for name in headings)
    for number, row in enumerate(_rows(starts, bench), start=1):
        yield f"{number:>5}" + "".join(f"{cell:>12}" for cell in _cells(row, bench))


def as_csv(starts: Starts, bench: TankScale = SIMULATION) -> str:
    """Return the starts as comma-separated values, in metres and seconds of the bench."""
    rows = [",".join(f"{value:.4f}" for value in row) for row in _rows(starts, bench)]
    return "\n".join([",".join(_COLUMNS), *rows, ""])


def as_sheet(starts: Starts, bench: TankScale, study: str) -> str:
    """Return a page to print and to take to the tank, with a small drawing of each throw.

    Args:
        starts: the throws.
        bench: scale of the tank.
        study: name of the study that they are for.
    """
    rows = []
    for number, row in enumerate(_rows(starts, bench), start=1):
        cells = "".join(f"<td>{cell}</td>" for cell in _cells(row, bench))
        rows.append(f"<tr><td>{number}</td>{cells}<td>{_drawing(row, bench)}</td><td>☐</td></tr>")
    headings = "".join(f"<th>{name}</th>" for name in ("throw", *_BENCH_HEADINGS, "", "done"))
    template = files("pipeline.results").joinpath("throw_sheet.html").read_text("utf-8")
    body = Template(template).substitute(
        n=len(starts), study=study, scale=f"{1000 * bench.scale:g}", headings=headings, rows="\n".join(rows)
    )
    return document(title="Throws to make", policy="", body=body, css=_SHEET_CSS)


_SHEET_CSS = """
.throws td, .throws th { text-align: right; padding: 0.15rem 0.6rem; vertical-align: middle; }
.throws svg { display: block; width: 5.5rem; height: 3.2rem; }
@media print { main { padding: 0; max-width: none; } body { font-size: 10pt; } tr { break-inside: avoid; } }
"""


def _drawing(row: tuple[float, ...], bench: TankScale) -> str:
    """Draw a bar over the waterline with an arrow of its velocity, as SVG."""
    length, y, angle, vx, vy, omega = row
    across = 4 * bench.scale  # from the waterline to the edge [m]
    unit = 20 / across
    width, height, middle = bench.scale**2 / length * unit, length * unit, -y * unit
    tip = (vx / bench.speed * 3.5, middle - vy / bench.speed * 3.5)
    turn = "↺" if omega > 0 else "↻"
    return (
        f'<svg viewBox="-34 -20 68 40"><path d="M-34 0H34" stroke="#5d9fcd"/>'
        f'<rect x="{-width / 2:.1f}" y="{-height / 2:.1f}" width="{width:.1f}" height="{height:.1f}" fill="#c9ced6" '
        f'stroke="#1d2129" stroke-width="0.5" transform="translate(0 {middle:.1f}) rotate({-angle:.0f})"/>'
        f'<path d="M0 {middle:.1f}L{tip[0]:.1f} {tip[1]:.1f}" stroke="#c2185b" stroke-width="1"/>'
        f'<circle cx="{tip[0]:.1f}" cy="{tip[1]:.1f}" r="1.3" fill="#c2185b"/>'
        f'<text x="26" y="-10" font-size="9">{turn}</text></svg>'
    )


def _cells(row: tuple[float, ...], bench: TankScale) -> list[str]:
    length, y, angle, vx, vy, omega = row
    if bench == SIMULATION:
        return [f"{length:.2f}", f"{y:z.2f}", f"{angle:.0f}", f"{vx:z.2f}", f"{vy:z.2f}", f"{omega:z.2f}"]
    turns = omega / (2 * np.pi)
    return [f"{1000 * length:.0f}", f"{1000 * y:z.0f}", f"{angle:.0f}", f"{vx:z.2f}", f"{vy:z.2f}", f"{turns:z.1f}"]


def _rows(starts: Starts, bench: TankScale) -> list[tuple[float, ...]]:
    """Return length [m], y [m], angle [degrees], vx, vy [m/s] and ω [rad/s] of each throw."""
    _, y, angle, vx, vy, omega = starts.state.astype(np.float64).T
    columns = (bench.scale * y, np.degrees(angle), bench.speed * vx, bench.speed * vy, omega / bench.time)
    lengths = (bench.scale * starts.length_scale).tolist()
    return list(zip(lengths, *(column.tolist() for column in columns), strict=True))
