"""Splits: cuts through parts larger than the print bed, with a dovetail that joins the pieces.

A cut crosses one link in the shape of a dovetail, as in a jigsaw puzzle: the pieces slide together along z, hold in the
plane, and are glued. The cut removes the clearance between the pieces.
"""

from dataclasses import dataclass
from math import cos, sin

import numpy as np
from shapely import LineString, Point, Polygon, affinity
from shapely.geometry.base import BaseGeometry

from tasks.bench.fabrication.built_bodies import Mechanism
from tasks.bench.fabrication.kit_settings import KitSettings
from tasks.bench.fabrication.printing import WALL_MM

CLEARANCE_MM = 0.2  # between the two sides of a dovetail
_BED_MARGIN_MM = 5.0  # along the edges of the bed
_STEP_MM = 3.0  # between the cuts tried along a link
_MAX_CUTS = 12  # more than any design of six links needs on a bed of 100 mm
_MAX_LENGTH = 1.3  # of a cut, in widths of the link; a longer one runs into another link
_OVERRUN_MM = 1.0  # of a cut beyond the outline
_ROUNDING_MM = 1e-6
MIN_PIECE_MM2 = 1.0  # less are crumbs of a cut that grazes an edge
_MIN_GAIN = 1e-9  # in bed sizes, so that rounding errors do not choose between equal cuts
_NECK, _HEAD, _DEPTH = 0.32, 0.46, 0.28  # narrowest and widest place and depth of a dovetail, in lengths of the cut


@dataclass(frozen=True, eq=False)
class Split:
    """The pieces of a part."""

    cuts: tuple[BaseGeometry, ...]  # areas removed between pieces
    pieces: tuple[Polygon, ...]  # outlines of the pieces along x; one if the part is whole
    fits: bool  # whether every piece fits the bed


def bed_mm(settings: KitSettings) -> tuple[float, float]:
    """Return the width and depth of the bed without its margins."""
    width, depth, _ = settings.bed_mm
    return (width - 2 * _BED_MARGIN_MM, depth - 2 * _BED_MARGIN_MM)


def turn_to_fit(shape: BaseGeometry, bed: tuple[float, float]) -> float | None:
    """Return the smallest turn [°, 0 to 179] that makes a shape fit a bed [mm], or None."""
    hull = np.array(shape.convex_hull.exterior.coords)
    turn = np.radians(np.arange(180))
    across = hull @ np.array([np.cos(turn), -np.sin(turn)])
    along = hull @ np.array([np.sin(turn), np.cos(turn)])
    fits = np.flatnonzero((np.ptp(across, axis=0) <= bed[0]) & (np.ptp(along, axis=0) <= bed[1]))
    return float(fits[0]) if fits.size else None


def split_of(mechanism: Mechanism, body: int, outline: Polygon, keep_off: BaseGeometry, settings: KitSettings) -> Split:
    """Cut the part with an index until every piece fits the bed, or no further cut misses what cuts must keep off."""
    bed, pieces = bed_mm(settings), [outline]
    cuts: list[BaseGeometry] = []
    while large := [piece for piece in pieces if turn_to_fit(piece, bed) is None]:
        best = _best_cut(large[0], mechanism, body, keep_off, settings) if len(cuts) < _MAX_CUTS else None
        if best is None:
            break
        pieces.remove(large[0])
        pieces.extend(best[1])
        cuts.append(best[0])
    pieces.sort(key=lambda piece: (piece.centroid.x, piece.centroid.y))
    return Split(tuple(cuts), tuple(pieces), not large)


def _size(shape: BaseGeometry, bed: tuple[float, float]) -> float:
    """Return the size of a shape relative to the bed, which 1 fills."""
    corners = np.array(shape.minimum_rotated_rectangle.exterior.coords)
    sides = np.sort(np.hypot(*(corners[1:3] - corners[:2]).T))
    return float((sides / np.sort(bed)).max())


def _best_cut(
    piece: Polygon, mechanism: Mechanism, body: int, keep_off: BaseGeometry, settings: KitSettings
) -> tuple[BaseGeometry, list[Polygon]] | None:
    """Find the cut whose larger half is smallest."""
    best, least = None, np.inf
    clear = keep_off.buffer(WALL_MM)
    for link in mechanism.bodies[body].links:
        width, height = mechanism.link_size[link]
        (x, y), angle = mechanism.link_centre[link], mechanism.link_angle[link]
        for along in np.arange(-height / 2 + _STEP_MM, height / 2, _STEP_MM):
            chord = _chord(piece, (x - sin(angle) * along, y + cos(angle) * along), angle, width)
            for flip in (1, -1) if chord else ():
                cut = _dovetail(chord, flip).buffer(CLEARANCE_MM / 2, join_style="mitre", cap_style="flat")
                halves = [half for half in getattr(piece.difference(cut), "geoms", []) if half.area > MIN_PIECE_MM2]
                if len(halves) != 2 or cut.intersects(clear):
                    continue
                size = max(_size(half, bed_mm(settings)) for half in halves)
                if size < least - _MIN_GAIN:
                    best, least = (cut, halves), size
    return best


def _chord(piece: Polygon, centre: tuple[float, float], angle: float, width: float) -> LineString | None:
    """Return the straight cut across a piece at a point of a link if it ends in the open near the link's sides."""
    across = LineString([(-2 * width, 0.0), (2 * width, 0.0)])
    line = affinity.translate(affinity.rotate(across, angle, origin=(0, 0), use_radians=True), *centre)
    inside = line.intersection(piece)
    for stretch in getattr(inside, "geoms", [inside]):
        if 0.0 < stretch.length < _MAX_LENGTH * width and stretch.distance(Point(centre)) < _ROUNDING_MM:
            beyond = affinity.scale(stretch, *(2 * [1.0 + 2 * _OVERRUN_MM / stretch.length]))
            return stretch if beyond.intersection(piece).length < stretch.length + _ROUNDING_MM else None
    return None


def _dovetail(chord: LineString, flip: int) -> LineString:
    """Return the line of a cut: straight, with a dovetail in the middle, and extended beyond the outline."""
    start, end = np.array(chord.coords)
    length = float(np.hypot(*(end - start)))
    along = (end - start) / length
    aside = flip * _DEPTH * length * np.array([-along[1], along[0]])
    middle, neck, head = (start + end) / 2, _NECK * length / 2 * along, _HEAD * length / 2 * along
    tail = [middle - neck, middle - head + aside, middle + head + aside, middle + neck]
    return LineString([start - _OVERRUN_MM * along, *tail, end + _OVERRUN_MM * along])
