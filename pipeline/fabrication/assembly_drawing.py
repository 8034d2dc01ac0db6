"""The assembly drawing on an A3 sheet: side view, top view, and tables of joints, parts and items to buy.

The views are to scale when printed at full size. The same kit gives the same bytes.
"""

import io
from collections.abc import Iterable, Sequence
from itertools import combinations, product
from math import atan2, cos, degrees, sin
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, PathPatch, Rectangle
from matplotlib.path import Path as MplPath
from shapely import LineString, Point, unary_union
from shapely import box as shapely_box
from shapely.geometry.base import BaseGeometry

from pipeline.fabrication.labels import Labels, around
from pipeline.report.drawing import INK
from tasks.fabrication.assembly import SIDES
from tasks.fabrication.kit import Kit
from tasks.fabrication.servo_joints import ServoJoint

_SHEET_MM = (420.0, 297.0)
_MARGIN_MM = 8.0
_SIDE_VIEW_MM = (20.0, 26.0, 232.0, 236.0)  # left, bottom, width and height, without dimensions
_COLUMN_X_MM, _COLUMN_WIDTH_MM = 284.0, 122.0  # of the tables and the top view
_TITLE_HEIGHT_MM = 30.0
_DRAWING_SCALES = (2.0, 1.0, 0.5, 0.4, 0.25, 0.2, 0.1, 0.05, 0.02, 0.01)
_GREY, _DARK_GREY, _RED = "#8a919c", "#3c3c42", "#b0123c"
PART_COLOURS = ("#d67a48", "#5c8ebe", "#78aa60", "#aa78b4", "#c9a43c", "#6f7f8f")
_SHEET_STYLE: dict[str, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "puddle",
    "pdf.fonttype": 42,
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 7.0,
    "text.color": INK,
    "lines.linewidth": 0.6,
    "patch.linewidth": 0.6,
    "hatch.linewidth": 0.3,
}
_CHANGING_METADATA = {  # left out, because the same kit gives the same bytes
    "svg": ("Creator", "Date", "Format", "Type"),
    "pdf": ("Creator", "Producer", "CreationDate"),
    "png": ("Software",),
}
_SMALL, _LARGE = 6.0, 13.0
_GRID_MM = 4.0  # of the candidate positions of a part's name
_DIMENSION_STEP_MM = 5.0  # between parallel dimensions
_SMALLEST_DISTANCE_MM = 0.05  # between joints; a smaller one would read 0.0
_SHORT_MM = 12.0  # a dimension too short for its text
_LABEL_SHARES = (0.5, 0.3, 0.7, 0.15, 0.85, 0.4, 0.6, 0.05, 0.95)  # of a part's length in the top view
_ARROWS = {"arrowstyle": "<|-|>", "color": INK, "lw": 0.5, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 5}


def assembly_drawing(kit: Kit, title: str, n_faults: int) -> dict[str, bytes]:
    """Draw a kit.

    Args:
        kit: The kit.
        title: Title of the sheet.
        n_faults: Number of faults of the parts and of the bench.

    Returns:
        The sheet as ``svg``, ``pdf`` and ``png``.
    """
    with mpl.rc_context(_SHEET_STYLE):
        width, height = _SHEET_MM
        figure = Figure(figsize=(width / 25.4, height / 25.4), facecolor="white")
        sheet = figure.add_axes((0, 0, 1, 1))
        sheet.set(xlim=(0, width), ylim=(0, height))
        sheet.axis("off")
        inner = (width - 2 * _MARGIN_MM, height - 2 * _MARGIN_MM)
        sheet.add_patch(Rectangle((_MARGIN_MM, _MARGIN_MM), *inner, fill=False, ec=INK, lw=0.9))
        bounds = np.array([outline.bounds for outline in kit.outlines])
        low, high = bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)
        scale = _side_view(sheet, kit, low, high)
        end = _tables(sheet, kit, n_faults)
        _top_view(sheet, kit, low, high, end - 14.0)
        _title_block(sheet, kit, title, scale)
        files = {}
        for form, changing in _CHANGING_METADATA.items():
            buffer = io.BytesIO()
            figure.savefig(buffer, format=form, metadata=dict.fromkeys(changing), dpi=150)
            files[form] = buffer.getvalue()
        return files


def _scale(size: Any, room: Any) -> float:
    """Return the largest standard scale at which a size fits."""
    return next(
        (scale for scale in _DRAWING_SCALES if (scale * np.array(size) <= np.array(room)).all()), _DRAWING_SCALES[-1]
    )


def _side_view(sheet: Axes, kit: Kit, low: Any, high: Any) -> float:
    """Draw a pontoon's parts from the right, x forward and y up. Returns the scale."""
    left, bottom, *room = _SIDE_VIEW_MM
    scale = _scale(high - low, room)
    corner = np.array([left, bottom]) + (np.array(room) - scale * (high - low)) / 2

    def put(points: Iterable[Sequence[float]]) -> Any:
        return (np.array(list(points), dtype=float) - low) * scale + corner

    heading = "Side view from the right, at rest (both pontoons)"
    sheet.text(left - 4, _SHEET_MM[1] - 18, heading, fontsize=9, weight="bold")
    order = sorted(range(len(kit.profiles)), key=lambda body: kit.layers.outer[body])
    for body in order:
        outer = kit.layers.outer[body]
        for piece in kit.splits[body].pieces:
            style = {"alpha": 0.45, "zorder": 3} if outer else {"alpha": 0.8, "zorder": 2}
            sheet.add_patch(_patch(piece, put, fc=PART_COLOURS[body % 6], ec=INK, **style))
        for link in kit.mechanism.bodies[body].links:
            dashed = _patch(kit.mechanism.links[link], put, fill=False, ec=_GREY, lw=0.25, ls=(0, (12, 8)), zorder=4)
            sheet.add_patch(dashed)
    for servo_joint in kit.servo_joints:
        for hollow in (servo_joint.pocket, servo_joint.recess):
            sheet.add_patch(_patch(hollow, put, fill=False, ec=INK, lw=0.4, ls=(0, (12, 8)), zorder=5))
    (x0, y0), (x1, y1) = put([low, high])
    labels = _labelled(sheet, kit, put, scale)
    _dimension(sheet, labels, (x0, y0 - 7), (x1, y0 - 7), f"{high[0] - low[0]:.1f}")
    _dimension(sheet, labels, (x1 + 8, y0), (x1 + 8, y1), f"{high[1] - low[1]:.1f}")
    return scale


def _labelled(sheet: Axes, kit: Kit, put: Any, scale: float) -> Labels:
    """Mark joints and rods, and label them, the parts and the distances between joints without overlaps."""
    labels = Labels(sheet)
    joints = [tuple(put([servo_joint.joint.at])[0]) for servo_joint in kit.servo_joints]
    rods = {
        f"R{body + 1}.{number}": tuple(put([rod])[0])
        for body, rods in enumerate(kit.layers.rods)
        for number, rod in enumerate(rods, 1)
    }
    labels.keep_off(*(Point(joint).buffer(2.5) for joint in joints), *(Point(rod).buffer(1.2) for rod in rods.values()))
    for servo_joint in kit.servo_joints:
        arc = _joint(sheet, servo_joint, kit.mechanism.link_centre[servo_joint.joint.link], put, scale)
        labels.keep_off(arc.buffer(0.4))
    for name, rod in rods.items():
        sheet.add_patch(Circle(rod, max(kit.settings.rod_mm / 2 * scale, 0.5), fc="white", ec=INK, zorder=6))
        labels.put(name, around(rod, (3.6, 5.0, 8.0, 12.0)), target=rod, fontsize=5.5)
    for servo_joint, joint in zip(kit.servo_joints, joints, strict=True):
        reach = max(servo_joint.recess_radius_mm * scale, 3.0) + 6.0
        places = around(joint, (reach, reach + 4, reach + 9, reach + 15))
        name = f"joint {servo_joint.joint.link}"
        labels.put(name, places, target=joint, color=_RED, weight="bold", fontsize=7.0)
    for body in range(len(kit.profiles)):
        inside = [tuple(place) for place in put(_inside(kit, body))]
        labels.put(f"part {body + 1}", inside, weight="bold", fontsize=7.0)
    ways = [
        (put([a.joint.at])[0], put([b.joint.at])[0], float(np.hypot(*np.subtract(a.joint.at, b.joint.at))))
        for a, b in combinations(kit.servo_joints, 2)
        if {a.carrier, a.driven} & {b.carrier, b.driven}
    ]
    measurable = [way for way in ways if way[2] >= _SMALLEST_DISTANCE_MM]
    for number, (start, end, apart) in enumerate(sorted(measurable, key=lambda way: way[2])):
        _aside(sheet, labels, start, end, f"{apart:.1f}", number)
    return labels


def _inside(kit: Kit, body: int) -> list[tuple[float, float]]:
    """Return positions for a part's name inside it, uncovered and deep ones first."""
    own = kit.profiles[body].polygon
    others = unary_union(kit.outlines[:body] + kit.outlines[body + 1 :])
    low_x, low_y, high_x, high_y = own.bounds
    grid = product(np.arange(low_x, high_x, _GRID_MM).tolist(), np.arange(low_y, high_y, _GRID_MM).tolist())
    inside = [place for place in grid if own.contains(Point(place))]
    if not inside:
        point = own.representative_point()
        return [(point.x, point.y)]
    depth = {place: own.boundary.distance(Point(place)) for place in inside}
    return sorted(inside, key=lambda place: (others.covers(Point(place)), -round(depth[place]), place))


def _aside(sheet: Axes, labels: Labels, start: Any, end: Any, text: str, number: int) -> None:
    """Draw a distance parallel to the line that it measures, each further out than the last."""
    along = np.subtract(end, start)
    length = float(np.hypot(*along))
    across = np.array([-along[1], along[0]]) / max(length, 1e-9)
    if across[0] > 0:
        across = -across
    out = _DIMENSION_STEP_MM * (number + 2) * across
    for point in (start, end):
        tip = point + out * (1 + 1.5 / np.hypot(*out))
        sheet.plot([point[0], tip[0]], [point[1], tip[1]], color=INK, lw=0.3, zorder=7)
        labels.keep_off(LineString([point, tip]).buffer(0.2))
    _dimension(sheet, labels, start + out, end + out, text)


def _joint(sheet: Axes, servo_joint: ServoJoint, child: Sequence[float], put: Any, scale: float) -> LineString:
    """Mark a joint's axis and the arc that the middle of its child link sweeps. Returns the arc."""
    (x, y), (child_x, child_y) = put([servo_joint.joint.at, child])
    reach = max(servo_joint.recess_radius_mm * scale, 3.0) + 4.0
    direction = atan2(child_y - y, child_x - x)
    swing = servo_joint.joint.motion_range
    ends = (direction - swing, direction + swing)
    angles = {"theta1": degrees(ends[0]), "theta2": degrees(ends[1])}
    sheet.add_patch(Arc((x, y), 2 * reach, 2 * reach, **angles, ec=_RED, lw=0.8, zorder=7))
    for at in ends:
        xs, ys = ([c + share * reach * f(at) for share in (0.55, 1.0)] for c, f in ((x, cos), (y, sin)))
        sheet.plot(xs, ys, color=_RED, lw=0.5, zorder=7)
    for dx, dy in ((2.2, 0.0), (0.0, 2.2)):
        sheet.plot([x - dx, x + dx], [y - dy, y + dy], color=INK, lw=0.5, zorder=7)
    return LineString([(x + reach * cos(at), y + reach * sin(at)) for at in np.linspace(*ends, 24)])


def _top_view(sheet: Axes, kit: Kit, low: Any, high: Any, top: float) -> None:
    """Draw the extents of all parts from above, x forward, with the right pontoon at the bottom."""
    settings = kit.settings
    deep = settings.pitch_mm + settings.thickness_mm
    behind = [servo_joint.servo.height_mm - settings.thickness_mm for servo_joint in kit.servo_joints]
    out = max(behind, default=0.0)
    room = (_COLUMN_WIDTH_MM - 40.0, top - _MARGIN_MM - _TITLE_HEIGHT_MM - 12.0)
    scale = _scale((high[0] - low[0], deep + 2 * out), room)
    corner = np.array([_COLUMN_X_MM + 12.0, top - 6.0 - (deep + out) * scale])

    def put(x: float, z: float) -> Any:
        return np.array([(x - low[0]) * scale + corner[0], (deep - z) * scale + corner[1]])

    sheet.text(_COLUMN_X_MM, top, f"Top view, 1 : {1 / scale:g}", fontsize=9, weight="bold")
    for body, rods in enumerate(kit.layers.rods):
        start, length = kit.layers.low_mm(body, settings), kit.layers.rod_length_mm(body, settings)
        for rod in rods:
            a, b = put(rod[0], start), put(rod[0], start + length)
            lw = max(1.0, settings.rod_mm * scale * 2.83)
            sheet.plot([a[0], b[0]], [a[1], b[1]], color=_GREY, lw=lw, zorder=2, solid_capstyle="butt")
    labels, names = Labels(sheet), {}
    for body, profile in enumerate(kit.profiles):
        x0, _, x1, _ = profile.polygon.bounds
        for side in SIDES:
            _, up = kit.placement(body, side)
            a, b = put(x0, up + settings.thickness_mm), put(x1, up)
            sheet.add_patch(Rectangle(a, *(b - a), fc=PART_COLOURS[body % 6], ec=INK, alpha=0.85, zorder=3))
            names[f"{body + 1}", (a[1] + b[1]) / 2] = (a[0], b[0])
    for item in kit.bought:
        if item.kind == "servo":
            box = item.solid.bounding_box()
            a, b = put(box.min.X, box.max.Z), put(box.max.X, box.min.Z)
            sheet.add_patch(Rectangle(a, *(b - a), fc=_DARK_GREY, ec=INK, alpha=0.8, zorder=5))
            labels.keep_off(shapely_box(*np.minimum(a, b), *np.maximum(a, b)))
    for (name, y), (start, end) in names.items():  # parts of one layer may overlap in this view
        labels.put(name, [(start + share * (end - start), y) for share in _LABEL_SHARES], fontsize=_SMALL)
    x_end = put(high[0], 0.0)[0]
    left, right = put(low[0], 0.0)[1], put(low[0], settings.pitch_mm)[1]
    _dimension(sheet, labels, (x_end + 7, right), (x_end + 7, left), f"{settings.pitch_mm:g}")
    for side, z in (("left", settings.thickness_mm / 2), ("right", deep - settings.thickness_mm / 2)):
        sheet.text(corner[0] - 3, put(low[0], z)[1], side, ha="right", va="center", fontsize=_SMALL)
    thick = f"{settings.thickness_mm:g} thick,\nlayers {settings.layer_gap_mm:g} apart"
    sheet.text(x_end + 11, put(0.0, deep)[1], thick, va="bottom", fontsize=_SMALL)


def _tables(sheet: Axes, kit: Kit, n_faults: int) -> float:
    """Draw the tables of joints, parts and items to buy. Returns the lower end [mm]."""
    x, y = _COLUMN_X_MM, _SHEET_MM[1] - 18.0
    joints = [["joint", "turns", "rest", "range", "servo in", "longer pulse"]]
    for servo_joint in kit.servo_joints:
        for side in servo_joint.sides(kit.settings.servos_per_joint):
            sense = "+" if kit.direction(servo_joint.joint.link, side) > 0 else "−"
            joint, carrier = servo_joint.joint, f"part {servo_joint.carrier + 1}, {side}"
            row = [
                f"{joint.link}",
                f"part {joint.child + 1} on {joint.parent + 1}",
                f"{degrees(joint.rest_angle):+.1f}°",
            ]
            joints.append([*row, f"±{degrees(joint.motion_range):.1f}°", carrier, f"{sense} angle"])
    y = _table(sheet, x, y, "Joints", joints, (10, 25, 19, 18, 25, 25))
    printed: dict[int, float] = {}
    for part in kit.parts:
        printed[part.body] = printed.get(part.body, 0.0) + part.mass_g
    rows = [["part", "links", "layer", "pieces", "size", "both copies"]]
    for body in kit.mechanism.bodies:
        x0, y0, x1, y1 = kit.profiles[body.index].polygon.bounds
        layer = "outer" if kit.layers.outer[body.index] else "inner"
        row = [f"{body.index + 1}", ", ".join(map(str, body.links)), layer, f"2 × {len(kit.splits[body.index].pieces)}"]
        rows.append([*row, f"{x1 - x0:.0f} × {y1 - y0:.0f}", f"{printed[body.index]:.0f} g"])
    y = _table(sheet, x, y - 6, "Parts", rows, (10, 25, 19, 18, 25, 25))
    bought = [["count", "item", "length", "note"]]
    bought += [
        [f"{line.count}", line.item, "" if line.length_mm is None else f"{line.length_mm:.1f}", line.note]
        for line in kit.bill
        if line.kind != "print"
    ]
    y = _table(sheet, x, y - 6, "To buy", bought, (10, 43, 14, 55))
    if n_faults:
        y -= 8
        warning = f"{n_faults} fault{'s' * (n_faults > 1)} found. Read the findings before you print."
        sheet.text(x, y, warning, color=_RED, weight="bold")
    return y


def _table(sheet: Axes, x: float, y: float, title: str, rows: list[list[str]], widths: Sequence[float]) -> float:
    """Draw a table downward from y. Returns its lower end [mm]."""
    sheet.text(x, y, title, fontsize=9, weight="bold")
    for number, row in enumerate(rows):
        y -= 4.6
        at = x
        for cell, width in zip(row, widths, strict=True):
            fits = int(width / 1.24)
            text = cell if len(cell) <= fits else cell[: fits - 1] + "…"
            sheet.text(at, y, text, fontsize=_SMALL, color=_GREY if number == 0 else INK)
            at += width
        if number == 0:
            sheet.plot([x, x + sum(widths)], [y - 1.2, y - 1.2], color=_GREY, lw=0.4)
    return y


def _title_block(sheet: Axes, kit: Kit, title: str, scale: float) -> None:
    width, height = _SHEET_MM[0] - _MARGIN_MM - _COLUMN_X_MM + 6.0, _TITLE_HEIGHT_MM
    x, y = _SHEET_MM[0] - _MARGIN_MM - width, _MARGIN_MM
    sheet.add_patch(Rectangle((x, y), width, height, fc="white", ec=INK, lw=0.9))
    ratio = f"1 : {1 / scale:g}"
    sheet.text(x + 4, y + height - 8, title, fontsize=_LARGE, weight="bold")
    lines = (
        f"Assembly. Dimensions in mm. Scale {ratio} on A3. {kit.settings.scale_mm_per_m:g} mm per metre of simulation.",
        f"PLA at {kit.settings.infill:.0%} infill; about {kit.mass_g:.0f} g with servos and steel.",
        "Dashed: links, servo pockets, horn recesses. R: rods. Red: range of a joint about rest.",
    )
    for number, line in enumerate(lines):
        sheet.text(x + 4, y + 13 - 5 * number, line, fontsize=_SMALL)


def _dimension(sheet: Axes, labels: Labels, a: Sequence[float], b: Sequence[float], text: str) -> None:
    """Draw a dimension with arrows and its length on it, or at one end if it is short."""
    sheet.annotate("", (a[0], a[1]), (b[0], b[1]), arrowprops=_ARROWS, zorder=8)
    along = np.subtract(b, a)
    slope = degrees(atan2(along[1], along[0]))
    upright = slope - 180.0 if slope > 90.0 else slope + 180.0 if slope <= -90.0 else slope
    places = [tuple(a + share * along) for share in (0.5, 0.4, 0.6, 0.3, 0.7)]
    if (length := float(np.hypot(*along))) < _SHORT_MM:
        places = [tuple(end + sign * _SHORT_MM / 2 * along / max(length, 1e-9)) for end, sign in ((b, 1), (a, -1))]
    labels.put(text, places, rotation=upright, fontsize=7.0)


def _patch(shape: BaseGeometry, put: Any, **style: Any) -> PathPatch:
    rings = [ring for part in getattr(shape, "geoms", [shape]) for ring in (part.exterior, *part.interiors)]
    path = MplPath.make_compound_path(*(MplPath(put(ring.coords), closed=True) for ring in rings))
    return PathPatch(path, **style)
