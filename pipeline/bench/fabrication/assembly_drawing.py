"""The assembly drawing on an A3 sheet: side view, perspective view, and a table of joints.

The side view is to scale when printed at full size. The same kit gives the same bytes.
"""

import io
from collections.abc import Callable, Iterable, Sequence
from itertools import product
from math import atan2, cos, degrees, pi, sin
from typing import Any

import matplotlib as mpl
import numpy as np
from build123d import Shape
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, PathPatch, Rectangle
from matplotlib.path import Path as MplPath
from shapely import LineString, Point, Polygon, box, unary_union
from shapely.geometry.base import BaseGeometry

from pipeline.report.drawing import INK
from tasks.arrays import Float64
from tasks.bench.fabrication.kit import Kit
from tasks.bench.fabrication.servo_joints import ServoJoint

_SHEET_MM = (420.0, 297.0)
_MARGIN_MM = 8.0
_SIDE_VIEW_MM = (20.0, 26.0, 232.0, 236.0)  # left, bottom, width and height, without dimensions
_COLUMN_X_MM, _COLUMN_WIDTH_MM = 284.0, 122.0  # of the tables and the perspective view
_TITLE_HEIGHT_MM = 30.0
_DRAWING_SCALES = (2.0, 1.0, 0.5, 0.4, 0.25, 0.2, 0.1, 0.05, 0.02, 0.01)
_GREY, _RED = "#8a919c", "#b0123c"
_PART_COLOURS = ("#d67a48", "#5c8ebe", "#78aa60", "#aa78b4", "#c9a43c", "#6f7f8f")
_STYLE: dict[str, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "puddle",
    "pdf.fonttype": 42,
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 7.0,
    "text.color": INK,
    "lines.linewidth": 0.6,
    "patch.linewidth": 0.6,
}
_CHANGING_METADATA = {  # left out, because the same kit gives the same bytes
    "svg": ("Creator", "Date", "Format", "Type"),
    "pdf": ("Creator", "Producer", "CreationDate"),
}
_SMALL, _LARGE = 6.0, 13.0
_GRID_MM = 4.0  # of the candidate positions of a part's name
_MM_PER_POINT = 25.4 / 72
_TO_EYE = np.array([550.0, 420.0, 720.0])  # ahead of the robot, above it and to its right
_POINTS_PER_EDGE = 12

Place = tuple[float, float]
Put = Callable[[Iterable[Sequence[float]]], Float64]  # from the robot's plane to the sheet [mm]


def perspective(robot: Shape) -> bytes:
    """Draw a robot as SVG."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(9, 6), facecolor="white")
        _view(figure, (0.02, 0.02, 0.96, 0.96), robot, 0.8)
        return _saved(figure, "svg")


def _view(figure: Figure, place: tuple[float, float, float, float], robot: Shape, width: float) -> None:
    """Draw the edges of a robot that are seen from ahead, above and the right, as lines of a width [points]."""
    middle = robot.bounding_box().center()
    eye = tuple(np.array([middle.X, middle.Y, middle.Z]) + _TO_EYE)
    seen, _ = robot.project_to_viewport(eye, (0, 1, 0), middle)
    shares = np.linspace(0, 1, _POINTS_PER_EDGE)
    edges = [np.array([(p.X, p.Y) for p in map(edge.position_at, shares)]) for edge in seen]
    axes = figure.add_axes(place)
    axes.axis("off")
    axes.set_aspect("equal")
    axes.add_collection(LineCollection(edges, colors=INK, linewidths=width))
    axes.autoscale()


def _saved(figure: Figure, form: str) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format=form, metadata=dict.fromkeys(_CHANGING_METADATA[form]))
    return buffer.getvalue()


def assembly_drawing(kit: Kit, robot: Shape, title: str) -> dict[str, bytes]:
    """Draw a kit and its robot. Returns ``svg`` and ``pdf``."""
    with mpl.rc_context(_STYLE):
        width, height = _SHEET_MM
        figure = Figure(figsize=(width / 25.4, height / 25.4), facecolor="white")
        sheet = figure.add_axes((0, 0, 1, 1))
        sheet.set(xlim=(0, width), ylim=(0, height))
        sheet.axis("off")
        inner = (width - 2 * _MARGIN_MM, height - 2 * _MARGIN_MM)
        sheet.add_patch(Rectangle((_MARGIN_MM, _MARGIN_MM), *inner, fill=False, ec=INK, lw=0.9))
        scale = _side_view(sheet, kit)
        lower_end = _table_of_joints(sheet, kit)
        bottom = _MARGIN_MM + _TITLE_HEIGHT_MM + 4
        view = (_COLUMN_X_MM / width, bottom / height, _COLUMN_WIDTH_MM / width, (lower_end - bottom - 6) / height)
        _view(figure, view, robot, 0.4)
        _title_block(sheet, kit, title, scale)
        return {form: _saved(figure, form) for form in _CHANGING_METADATA}


def _side_view(sheet: Axes, kit: Kit) -> float:
    """Draw a pontoon's parts from the right, x forward and y up. Returns the scale."""
    bounds = np.array([outline.bounds for outline in kit.outlines])
    low, high = bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)
    left, bottom, *room = _SIDE_VIEW_MM
    fitting = [scale for scale in _DRAWING_SCALES if (scale * (high - low) <= np.array(room)).all()]
    scale = max(fitting, default=_DRAWING_SCALES[-1])
    corner = np.array([left, bottom]) + (np.array(room) - scale * (high - low)) / 2

    def put(points: Iterable[Sequence[float]]) -> Float64:
        return np.asarray((np.array(list(points), dtype=float) - low) * scale + corner)

    heading = "Side view from the right, at rest (both pontoons)"
    sheet.text(left - 4, _SHEET_MM[1] - 18, heading, fontsize=9, weight="bold")
    for body in sorted(range(len(kit.profiles)), key=lambda body: kit.layers.outer[body]):
        style = {"alpha": 0.45, "zorder": 3} if kit.layers.outer[body] else {"alpha": 0.8, "zorder": 2}
        for piece in kit.splits[body].pieces:
            sheet.add_patch(_patch(piece, put, fc=_PART_COLOURS[body % 6], ec=INK, **style))
        for link in kit.mechanism.bodies[body].links:
            dashed = _patch(kit.mechanism.links[link], put, fill=False, ec=_GREY, lw=0.25, ls=(0, (12, 8)), zorder=4)
            sheet.add_patch(dashed)
    for servo_joint in kit.servo_joints:
        for hollow in (servo_joint.pocket, servo_joint.recess):
            sheet.add_patch(_patch(hollow, put, fill=False, ec=INK, lw=0.4, ls=(0, (12, 8)), zorder=5))
    _label(sheet, kit, put, scale)
    (x0, y0), (x1, y1) = put([low, high])
    _dimension(sheet, (x0, y0 - 7), (x1, y0 - 7), f"{high[0] - low[0]:.1f}")
    _dimension(sheet, (x1 + 8, y0), (x1 + 8, y1), f"{high[1] - low[1]:.1f}")
    return scale


class _Labels:
    """The labels of a sheet, each written where it covers the least."""

    def __init__(self, sheet: Axes, marks: Iterable[BaseGeometry]) -> None:
        self._sheet, self._taken = sheet, list(marks)

    def put(self, text: str, places: Iterable[Place], *, fontsize: float, **style: Any) -> None:
        """Write a text at the first of the places [mm] at which it covers the least."""
        half_w, half_h = 0.35 * fontsize * len(text) * _MM_PER_POINT, 0.7 * fontsize * _MM_PER_POINT

        def area(place: Place) -> Polygon:
            return box(place[0] - half_w, place[1] - half_h, place[0] + half_w, place[1] + half_h)

        best = min(places, key=lambda at: round(sum(area(at).intersection(other).area for other in self._taken), 3))
        self._taken.append(area(best))
        frame = {"boxstyle": "square,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.8}
        self._sheet.text(*best, text, ha="center", va="center", fontsize=fontsize, zorder=9, bbox=frame, **style)


def _around(place: Place, distances: Sequence[float]) -> list[Place]:
    """List places on circles of some radii [mm] around a place."""
    turns = pi / 4 + np.arange(12) * pi / 6
    return [(place[0] + r * cos(turn), place[1] + r * sin(turn)) for r in distances for turn in turns]


def _label(sheet: Axes, kit: Kit, put: Put, scale: float) -> None:
    """Mark joints and rods, and name them and the parts."""
    rods = {
        f"R{body + 1}.{number}": tuple(put([rod])[0])
        for body, rods in enumerate(kit.layers.rods)
        for number, rod in enumerate(rods, 1)
    }
    arcs = [_joint(sheet, servo_joint, kit, put, scale) for servo_joint in kit.servo_joints]
    labels = _Labels(sheet, [*arcs, *(Point(rod).buffer(1.2) for rod in rods.values())])
    for name, rod in rods.items():
        sheet.add_patch(Circle(rod, max(kit.settings.rod_mm / 2 * scale, 0.5), fc="white", ec=INK, zorder=6))
        labels.put(name, _around(rod, (3.6, 5.0, 8.0)), fontsize=5.5)
    for servo_joint in kit.servo_joints:
        reach = max(servo_joint.recess_radius_mm * scale, 3.0) + 6.0
        places = _around(tuple(put([servo_joint.joint.at])[0]), (reach, reach + 4, reach + 9))
        labels.put(f"joint {servo_joint.joint.link}", places, color=_RED, weight="bold", fontsize=7.0)
    for body, outline in enumerate(kit.outlines):
        others = unary_union([other for other in kit.outlines if other is not outline])
        low_x, low_y, high_x, high_y = outline.bounds
        grid = [Point(at) for at in product(np.arange(low_x, high_x, _GRID_MM), np.arange(low_y, high_y, _GRID_MM))]
        inside = [point for point in grid if outline.contains(point)] or [outline.representative_point()]
        inside.sort(key=lambda point: (others.covers(point), -outline.boundary.distance(point)))
        places = [tuple(at) for at in put([(point.x, point.y) for point in inside])]
        labels.put(f"part {body + 1}", places, weight="bold", fontsize=7.0)


def _joint(sheet: Axes, servo_joint: ServoJoint, kit: Kit, put: Put, scale: float) -> BaseGeometry:
    """Mark a joint's axis and the arc that the middle of its child link sweeps. Returns what is marked."""
    joint = servo_joint.joint
    (x, y), (child_x, child_y) = put([joint.at, kit.mechanism.link_centre[joint.link]])
    reach = max(servo_joint.recess_radius_mm * scale, 3.0) + 4.0
    direction = atan2(child_y - y, child_x - x)
    ends = (direction - joint.reach, direction + joint.reach)
    angles = {"theta1": degrees(ends[0]), "theta2": degrees(ends[1])}
    sheet.add_patch(Arc((x, y), 2 * reach, 2 * reach, **angles, ec=_RED, lw=0.8, zorder=7))
    for at in ends:
        xs, ys = ([c + share * reach * f(at) for share in (0.55, 1.0)] for c, f in ((x, cos), (y, sin)))
        sheet.plot(xs, ys, color=_RED, lw=0.5, zorder=7)
    for dx, dy in ((2.2, 0.0), (0.0, 2.2)):
        sheet.plot([x - dx, x + dx], [y - dy, y + dy], color=INK, lw=0.5, zorder=7)
    arc = LineString([(x + reach * cos(at), y + reach * sin(at)) for at in np.linspace(*ends, 24)])
    return unary_union([arc.buffer(0.4), Point(x, y).buffer(2.5)])


def _table_of_joints(sheet: Axes, kit: Kit) -> float:
    """Draw the table of joints. Returns its lower end [mm]."""
    x, y, widths = _COLUMN_X_MM, _SHEET_MM[1] - 18.0, (10, 25, 19, 18, 25, 25)
    rows = [["joint", "turns", "rest", "range", "servo in", "longer pulse"]]
    for servo_joint in kit.servo_joints:
        joint = servo_joint.joint
        turns, rest = f"part {joint.child + 1} on {joint.parent + 1}", f"{degrees(joint.rest_angle):+.1f}°"
        for side in servo_joint.sides:
            sense = "+ angle" if kit.direction(servo_joint, side) > 0 else "− angle"
            carrier = f"part {servo_joint.carrier + 1}, {side}"
            rows.append([f"{joint.link}", turns, rest, f"±{degrees(joint.reach):.1f}°", carrier, sense])
    sheet.text(x, y, "Joints", fontsize=9, weight="bold")
    for number, row in enumerate(rows):
        y -= 4.6
        for cell, at in zip(row, x + np.cumsum((0, *widths[:-1])), strict=True):
            sheet.text(at, y, cell, fontsize=_SMALL, color=_GREY if number == 0 else INK)
        if number == 0:
            sheet.plot([x, x + sum(widths)], [y - 1.2, y - 1.2], color=_GREY, lw=0.4)
    return y


def _title_block(sheet: Axes, kit: Kit, title: str, scale: float) -> None:
    width, height, settings = _SHEET_MM[0] - _MARGIN_MM - _COLUMN_X_MM + 6.0, _TITLE_HEIGHT_MM, kit.settings
    x, y = _SHEET_MM[0] - _MARGIN_MM - width, _MARGIN_MM
    sheet.add_patch(Rectangle((x, y), width, height, fc="white", ec=INK, lw=0.9))
    sheet.text(x + 4, y + height - 8, title, fontsize=_LARGE, weight="bold")
    lines = (
        f"Dimensions in mm. Scale 1 : {1 / scale:g} on A3. {settings.scale_mm_per_m:g} mm per metre of simulation.",
        f"Pontoons {settings.pitch_mm:g} apart, parts {settings.thickness_mm:g} thick, {settings.infill:.0%} infill; "
        f"{kit.mass_g:.0f} g.",
        "Dashed: links, servo pockets, horn recesses. R: rods. Red: range of a joint about rest.",
    )
    for number, line in enumerate(lines):
        sheet.text(x + 4, y + 13 - 5 * number, line, fontsize=_SMALL)


def _dimension(sheet: Axes, a: Place, b: Place, text: str) -> None:
    """Draw a horizontal or vertical dimension with arrows and its length on it."""
    arrows = {"arrowstyle": "<|-|>", "color": INK, "lw": 0.5, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 5}
    sheet.annotate("", a, b, arrowprops=arrows, zorder=8)
    frame = {"boxstyle": "square,pad=0.2", "fc": "white", "ec": "none"}
    turn = 0 if a[1] == b[1] else 90
    middle = ((a[0] + b[0]) / 2, (a[1] + b[1]) / 2)
    sheet.text(*middle, text, ha="center", va="center", rotation=turn, fontsize=7.0, zorder=9, bbox=frame)


def _patch(shape: BaseGeometry, put: Put, **style: Any) -> PathPatch:
    rings = [ring for part in getattr(shape, "geoms", [shape]) for ring in (part.exterior, *part.interiors)]
    path = MplPath.make_compound_path(*(MplPath(put(ring.coords), closed=True) for ring in rings))
    return PathPatch(path, **style)
