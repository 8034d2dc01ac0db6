"""Labels of a drawing, each placed where it covers the least."""

from collections.abc import Iterable, Iterator, Sequence
from math import cos, pi, sin
from typing import Any

from matplotlib.axes import Axes
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath
from shapely import LineString, Point, Polygon, affinity, box
from shapely.geometry.base import BaseGeometry

from pipeline.report.drawing import INK

_MM_PER_POINT = 25.4 / 72
_PAD_MM = 0.6  # around the letters
_LEADER_MM = 6.0  # distance from a label to its target beyond which a leader line joins them
_TEXT_COST, _LINE_COST = 10.0, 1.0  # per mm² of another label covered, and of a mark or a line

_PLACES_PER_CIRCLE = 12

Place = tuple[float, float]


class Labels:
    """The labels of one sheet, in mm."""

    def __init__(self, sheet: Axes) -> None:
        self._sheet = sheet
        self.boxes: list[Polygon] = []
        """Boxes of the labels so far."""
        self._marks: list[BaseGeometry] = []

    def keep_off(self, *shapes: BaseGeometry) -> None:
        """Record shapes that labels should not cover."""
        self._marks += shapes

    def put(
        self, text: str, places: Iterable[Place], *, target: Place | None = None, rotation: float = 0.0, **style: Any
    ) -> None:
        """Write a label at the best of some places.

        Args:
            text: The label.
            places: Candidates for its middle [mm]; the first of equally good ones is taken.
            target: What it labels; a leader line joins a distant label to it.
            rotation: Rotation [°].
            style: Text properties of matplotlib, including fontsize.
        """
        letters = _box(text, style["fontsize"], style.get("weight", "normal"))
        lying = affinity.rotate(letters, rotation, origin=(0, 0))
        costs: dict[Place, float] = {}
        for place in places:
            costs[place] = self._cost(affinity.translate(lying, *place))
            if costs[place] == 0.0:
                break
        best = min(costs, key=costs.__getitem__)
        where = affinity.translate(lying, *best)
        self.boxes.append(where)
        if target is not None:
            leader = LineString([target, where.boundary.interpolate(where.boundary.project(Point(target)))])
            if leader.length > _LEADER_MM:
                self._sheet.plot(*leader.xy, color=style.get("color", INK), lw=0.35, zorder=8)
                self._marks.append(leader.buffer(0.3))
        pad = _PAD_MM / _MM_PER_POINT / style["fontsize"]
        frame = {"boxstyle": f"square,pad={pad:.3f}", "fc": "white", "ec": "none", "alpha": 0.8}
        self._sheet.text(*best, text, ha="center", va="center", rotation=rotation, zorder=9, bbox=frame, **style)

    def _cost(self, where: Polygon) -> float:
        text = sum(float(where.intersection(other).area) for other in self.boxes)
        return _TEXT_COST * text + _LINE_COST * sum(float(where.intersection(mark).area) for mark in self._marks)


def _box(text: str, fontsize: float, weight: str) -> Polygon:
    """Return the box of a text around the origin [mm], with the height of a line."""
    font = FontProperties(family="DejaVu Sans", weight=weight)
    width = TextPath((0, 0), text, size=fontsize, prop=font).get_extents().width * _MM_PER_POINT
    half_w, half_h = width / 2 + _PAD_MM, fontsize * _MM_PER_POINT / 2 + _PAD_MM
    return box(-half_w, -half_h, half_w, half_h)


def around(place: Place, distances: Sequence[float]) -> Iterator[Place]:
    """Yield places on circles of some radii [mm] around a place, from its upper right to the opposite side."""
    for distance in distances:
        for step in range(_PLACES_PER_CIRCLE):
            angle = pi / 4 + (-1) ** step * ((step + 1) // 2) * 2 * pi / _PLACES_PER_CIRCLE
            yield place[0] + distance * cos(angle), place[1] + distance * sin(angle)
