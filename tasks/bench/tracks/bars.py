"""The bars that are thrown, and what they are in the simulation: links with an area of 1 m² and one density."""

from dataclasses import dataclass

import numpy as np

from tasks.arrays import Float64, Labels
from tasks.bench.tracks.conventions import Tracks
from tasks.bench.tracks.table import TrackError, first
from tasks.design import GENES

_TOLERANCE = 0.1  # share by which a bar may differ from a link


class TrackedBarError(TrackError):
    """A bar is none that networks can learn from, rather than its track."""


@dataclass(frozen=True, eq=False)
class Bars:
    """The bar of each throw; axis 0 is the throw."""

    throw: Labels
    length: Float64  # long axis, in the file's unit
    width: Float64
    mass: Float64  # [kg]


def length_scales(bars: Bars, tracks: Tracks) -> dict[str, float]:
    """Return the long axis of each throw's bar [m of simulation], by the throw's label."""
    for name in ("length", "width", "mass"):
        values = getattr(bars, name)
        if (k := first(~(np.isfinite(values) & (values > 0)))) is not None:
            raise TrackedBarError(
                f"throw {bars.throw[k]}: the bar's {name} is {values[k]:g}, expected a number above 0: measure the bar"
            )
    repeated, n = np.unique(bars.throw, return_counts=True)
    if (k := first(n > 1)) is not None:
        raise TrackedBarError(f"throw {repeated[k]} has {n[k]} bars, expected one: give each throw a number of its own")
    unit = tracks.simulated_unit
    length, width = bars.length * unit, bars.width * unit
    gene = next(gene for gene in GENES if gene.name == "length_scale")
    least, greatest = gene.low * (1 - _TOLERANCE), gene.high * (1 + _TOLERANCE)
    if (k := first((length < least) | (length > greatest))) is not None:
        raise TrackedBarError(
            f"throw {bars.throw[k]}: the bar's length is {bars.length[k]:g} {tracks.length_unit}, or {length[k]:.3g} m "
            f"of simulation: expected {gene.low:g} to {gene.high:g} m of simulation, which is "
            f"{gene.low / unit:.4g} to {gene.high / unit:.4g} {tracks.length_unit}: check tracks.length_unit (m or "
            f"mm) and tracks.metres_per_metre"
        )
    area = length * width
    if (k := first(np.abs(area - 1) > _TOLERANCE)) is not None:
        raise TrackedBarError(
            f"throw {bars.throw[k]}: the bar is {bars.length[k]:g} by {bars.width[k]:g} {tracks.length_unit}: expected "
            f"a width of {1 / (length[k] * unit):.4g} {tracks.length_unit}, because every link has an area of 1 m² of "
            f"simulation: measure the bar, or check tracks.length_unit and tracks.metres_per_metre"
        )
    light, heavy = int(np.argmin(bars.mass)), int(np.argmax(bars.mass))
    if bars.mass[heavy] * (1 - _TOLERANCE) > bars.mass[light] * (1 + _TOLERANCE):
        raise TrackedBarError(
            f"the bar of throw {bars.throw[light]} has a mass of {bars.mass[light]:g} kg and that of throw "
            f"{bars.throw[heavy]} one of {bars.mass[heavy]:g} kg: expected equal masses, because every link has the "
            f"same: ballast the bars"
        )
    return dict(zip(map(str, bars.throw), length.tolist(), strict=True))
