"""The assembly drawing, on a sheet of A3: the robot from its side and from above, its joints, parts and rods.

Lengths on the sheet are to scale when it is printed at its own size. The same kit gives the same bytes.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from itertools import combinations
from math import atan2, cos, degrees, pi, sin
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, PathPatch, Rectangle
from matplotlib.path import Path as MplPath
from shapely import Point, Polygon, unary_union
from shapely.geometry.base import BaseGeometry

from tasks.fabrication.drives import Drive
from tasks.fabrication.kit import Kit
from tasks.fabrication.parts import SIDES, placement

SHEET_MM = (420.0, 297.0)
MARGIN_MM = 8.0
SIDE_VIEW = (20.0, 26.0, 232.0, 236.0)
"""Room on the sheet for the view from the side, without its dimensions: left, bottom, width, height [mm]."""
COLUMN_X, COLUMN_WIDTH = 284.0, 122.0
"""Of the tables and the view from above."""
TITLE_HEIGHT = 30.0
SCALES = (2.0, 1.0, 0.5, 0.4, 0.25, 0.2, 0.1, 0.05, 0.02, 0.01)
INK, FAINT = "#1d2129", "#8a919c"
PART_COLOURS = ("#d67a48", "#5c8ebe", "#78aa60", "#aa78b4", "#c9a43c", "#6f7f8f")
STYLE: dict[str, Any] = {
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
SMALL, LARGE = 6.0, 13.0
DIMENSION: dict[str, Any] = {
    "arrowstyle": "<|-|>", "color": INK, "lw": 0.5, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 5,
}  # fmt: skip


def assembly_drawing(kit: Kit, title: str) -> dict[str, bytes]:
    """Draw a kit.

    Returns:
        The same sheet as ``svg``, ``pdf`` and ``png``.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(SHEET_MM[0] / 25.4, SHEET_MM[1] / 25.4), facecolor="white")
        sheet = figure.add_axes((0, 0, 1, 1))
        sheet.set(xlim=(0, SHEET_MM[0]), ylim=(0, SHEET_MM[1]))
        sheet.axis("off")
        sheet.add_patch(Rectangle((MARGIN_MM, MARGIN_MM), SHEET_MM[0] - 2 * MARGIN_MM, SHEET_MM[1] - 2 * MARGIN_MM,
                                  fill=False, ec=INK, lw=0.9))  # fmt: skip
        low, high = _bounds([profile.polygon for profile in kit.profiles])
        scale = _side_view(sheet, kit, low, high)
        end = _tables(sheet, kit)
        _top_view(sheet, kit, low, high, end - 14.0)
        _title_block(sheet, kit, title, scale)
        return {
            "svg": _saved(figure, "svg", {"Creator": None, "Date": None, "Format": None, "Type": None}),
            "pdf": _saved(figure, "pdf", {"Creator": None, "Producer": None, "CreationDate": None}),
            "png": _saved(figure, "png", {"Software": None}),
        }


def _saved(figure: Figure, form: str, metadata: dict[str, None]) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format=form, metadata=metadata, dpi=150)
    return buffer.getvalue()


def _bounds(outlines: Sequence[Polygon]) -> tuple[Any, Any]:
    bounds = np.array([outline.bounds for outline in outlines])
    return bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)


def _scale(size: Any, room: Any) -> float:
    """Give the largest of the usual scales at which something fits."""
    return next((scale for scale in SCALES if (scale * np.array(size) <= np.array(room)).all()), SCALES[-1])


def _side_view(sheet: Axes, kit: Kit, low: Any, high: Any) -> float:
    """Draw a pontoon's parts in their plane, seen from the right: x forward, y up. Give the scale."""
    left, bottom, *room = SIDE_VIEW
    scale = _scale(high - low, room)
    corner = np.array([left, bottom]) + (np.array(room) - scale * (high - low)) / 2

    def put(points: Iterable[Sequence[float]]) -> Any:
        return (np.array(list(points), dtype=float) - low) * scale + corner

    sheet.text(left - 4, SHEET_MM[1] - 18, "From the right, at rest; both pontoons alike", fontsize=9, weight="bold")
    order = sorted(range(len(kit.profiles)), key=lambda body: kit.layers.outer[body])
    for body in order:
        outer = kit.layers.outer[body]
        for piece in kit.splits[body].pieces:
            sheet.add_patch(_patch(piece, put, fc=PART_COLOURS[body % 6], ec=INK, alpha=0.45 if outer else 0.8,
                                   zorder=3 if outer else 2))  # fmt: skip
        for link in kit.mechanism.bodies[body].links:
            dashed = _patch(kit.mechanism.links[link], put, fill=False, ec=FAINT, lw=0.25, ls=(0, (3, 3)), zorder=4)
            sheet.add_patch(dashed)
    for drive in kit.drives:
        for hollow in (drive.pocket, drive.recess):
            sheet.add_patch(_patch(hollow, put, fill=False, ec=INK, lw=0.4, ls=(0, (2, 1.5)), zorder=5))
        _joint(sheet, drive, kit.mechanism.link_centre[drive.joint.link], put, scale)
    for body, rods in enumerate(kit.layers.rods):
        for number, rod in enumerate(rods, 1):
            (x, y), = put([rod])
            sheet.add_patch(Circle((x, y), max(kit.settings.rod_mm / 2 * scale, 0.5), fc="white", ec=INK, zorder=6))
            sheet.text(x + 1.4, y + 1.2, f"R{body + 1}.{number}", fontsize=5.5, zorder=8)
    for body, profile in enumerate(kit.profiles):
        inside = profile.polygon.difference(_clutter(kit, body))
        at = (inside if not inside.is_empty else profile.polygon).representative_point()
        (x, y), = put([(at.x, at.y)])
        sheet.text(x, y, f"part {body + 1}", ha="center", va="center", weight="bold", zorder=8,
                   bbox={"boxstyle": "round,pad=0.2", "fc": "white", "ec": "none", "alpha": 0.75})  # fmt: skip
    for a, b in combinations(kit.drives, 2):
        if {a.carrier, a.driven} & {b.carrier, b.driven}:
            from_a, to_b = put([a.joint.at, b.joint.at])
            apart = np.hypot(*np.subtract(a.joint.at, b.joint.at))
            _dimension(sheet, from_a, to_b, f"{apart:.1f}")
    (x0, y0), (x1, y1) = put([low, high])
    _dimension(sheet, (x0, y0 - 7), (x1, y0 - 7), f"{high[0] - low[0]:.1f}")
    _dimension(sheet, (x1 + 8, y0), (x1 + 8, y1), f"{high[1] - low[1]:.1f}")
    return scale


def _clutter(kit: Kit, body: int) -> BaseGeometry:
    """Give what a label had better not lie on."""
    others = [profile.polygon for index, profile in enumerate(kit.profiles) if index != body]
    joints = [Point(drive.joint.at).buffer(30.0) for drive in kit.drives]
    cuts = [cut.buffer(20.0) for cut in kit.splits[body].cuts]
    return unary_union([*others, *joints, *cuts])


def _joint(sheet: Axes, drive: Drive, child: Sequence[float], put: Any, scale: float) -> None:
    """Mark a joint's axis, its number, and the sector that its child link's middle sweeps about rest."""
    (x, y), (child_x, child_y) = put([drive.joint.at, child])
    reach = max(drive.recess_radius_mm * scale, 3.0) + 4.0
    direction = degrees(atan2(child_y - y, child_x - x))
    swing = degrees(drive.joint.motion_range)
    sheet.add_patch(Arc((x, y), 2 * reach, 2 * reach, theta1=direction - swing, theta2=direction + swing, ec="#b0123c",
                        lw=0.8, zorder=7))  # fmt: skip
    for side in (-1, 1):
        at = direction * pi / 180 + side * drive.joint.motion_range
        sheet.plot([x + 0.55 * reach * cos(at), x + reach * cos(at)], [y + 0.55 * reach * sin(at), y + reach * sin(at)],
                   color="#b0123c", lw=0.5, zorder=7)  # fmt: skip
    for dx, dy in ((2.2, 0.0), (0.0, 2.2)):
        sheet.plot([x - dx, x + dx], [y - dy, y + dy], color=INK, lw=0.5, zorder=7)
    sheet.text(x + reach * 0.75, y + reach * 0.8, f"joint {drive.joint.link}", color="#b0123c", weight="bold", zorder=9,
               bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.75})  # fmt: skip


def _top_view(sheet: Axes, kit: Kit, low: Any, high: Any, top: float) -> None:
    """Draw both pontoons from above: x forward, the right pontoon at the bottom; parts by their extent."""
    settings = kit.settings
    deep = settings.pitch_mm + settings.thickness_mm
    out = max((drive.servo.height_mm - settings.thickness_mm for drive in kit.drives), default=0.0)  # behind a part
    room = (COLUMN_WIDTH - 40.0, top - MARGIN_MM - TITLE_HEIGHT - 12.0)
    scale = _scale((high[0] - low[0], deep + 2 * out), room)
    corner = np.array([COLUMN_X + 12.0, top - 6.0 - (deep + out) * scale])

    def put(x: float, z: float) -> Any:
        return np.array([(x - low[0]) * scale + corner[0], (deep - z) * scale + corner[1]])

    sheet.text(COLUMN_X, top, f"From above, 1 : {1 / scale:g}", fontsize=9, weight="bold")
    for body, rods in enumerate(kit.layers.rods):
        start, length = kit.layers.back_mm(body, settings), kit.layers.rod_length_mm(body, settings)
        for rod in rods:
            a, b = put(rod[0], start), put(rod[0], start + length)
            sheet.plot([a[0], b[0]], [a[1], b[1]], color=FAINT, lw=max(1.0, settings.rod_mm * scale * 2.83), zorder=2,
                       solid_capstyle="butt")  # fmt: skip
    for body, profile in enumerate(kit.profiles):
        x0, _, x1, _ = profile.polygon.bounds
        for side in SIDES:
            _, up = placement(body, side, kit.layers, settings)
            a, b = put(x0, up + settings.thickness_mm), put(x1, up)
            sheet.add_patch(Rectangle(a, *(b - a), fc=PART_COLOURS[body % 6], ec=INK, alpha=0.85, zorder=3))
            along = (body + 1) / (len(kit.profiles) + 1)  # parts of one layer may lie over one another
            sheet.text(a[0] + along * (b[0] - a[0]), (a[1] + b[1]) / 2, f"{body + 1}", ha="center", va="center",
                       fontsize=SMALL, zorder=6)  # fmt: skip
    for item in kit.bought:
        if item.kind == "servo":
            box = item.solid.bounding_box()
            a, b = put(box.min.X, box.max.Z), put(box.max.X, box.min.Z)
            sheet.add_patch(Rectangle(a, *(b - a), fc="#3c3c42", ec=INK, alpha=0.8, zorder=5))
    x_end = put(high[0], 0.0)[0]
    left, right = put(low[0], 0.0)[1], put(low[0], settings.pitch_mm)[1]
    _dimension(sheet, (x_end + 7, right), (x_end + 7, left), f"{settings.pitch_mm:g}")
    left_middle = put(low[0], settings.thickness_mm / 2)[1]
    sheet.text(corner[0] - 3, left_middle, "left", ha="right", va="center", fontsize=SMALL)
    right_middle = put(low[0], deep - settings.thickness_mm / 2)[1]
    sheet.text(corner[0] - 3, right_middle, "right", ha="right", va="center", fontsize=SMALL)
    thick = f"{settings.thickness_mm:g} thick,\nlayers {settings.layer_gap_mm:g} apart"
    sheet.text(x_end + 11, put(0.0, deep)[1], thick, va="bottom", fontsize=SMALL)


def _tables(sheet: Axes, kit: Kit) -> float:
    """List joints, parts and what to buy on the right; give where the tables end."""
    x, y = COLUMN_X, SHEET_MM[1] - 18.0
    joints = [["joint", "turns", "rest", "range", "servo in", "longer pulse"]]
    for drive in kit.drives:
        for side in drive.sides(kit.settings.servos_per_joint):
            sense = "+" if kit.direction(drive.joint.link, side) > 0 else "−"
            joints.append([
                f"{drive.joint.link}",
                f"part {drive.joint.child + 1} on {drive.joint.parent + 1}",
                f"{degrees(drive.joint.rest_angle):+.1f}°",
                f"±{degrees(drive.joint.motion_range):.1f}°",
                f"part {drive.carrier + 1}, {side}",
                f"{sense} angle",
            ])
    y = _table(sheet, x, y, "Joints", joints, (10, 25, 19, 18, 25, 25))
    printed: dict[int, float] = {}
    for part in kit.parts:
        printed[part.body] = printed.get(part.body, 0.0) + part.mass_g
    rows = [["part", "links", "layer", "pieces", "size", "both copies"]]
    for body in kit.mechanism.bodies:
        x0, y0, x1, y1 = kit.profiles[body.index].polygon.bounds
        rows.append([
            f"{body.index + 1}",
            ", ".join(map(str, body.links)),
            "outer" if kit.layers.outer[body.index] else "inner",
            f"2 × {len(kit.splits[body.index].pieces)}",
            f"{x1 - x0:.0f} × {y1 - y0:.0f}",
            f"{printed[body.index]:.0f} g",
        ])
    y = _table(sheet, x, y - 6, "Parts", rows, (10, 25, 19, 18, 25, 25))
    bought = [["count", "item", "length", "note"]]
    bought += [
        [f"{line.count}", line.item, "" if line.length_mm is None else f"{line.length_mm:.1f}", line.note]
        for line in kit.bill
        if line.kind != "print"
    ]
    y = _table(sheet, x, y - 6, "To buy", bought, (10, 43, 14, 55))
    n = len(kit.faults)
    if n:
        y -= 8
        said = f"{n} fault{'s' * (n > 1)} found: read the findings before you print."
        sheet.text(x, y, said, color="#b0123c", weight="bold")
    return y


def _table(sheet: Axes, x: float, y: float, title: str, rows: list[list[str]], widths: Sequence[float]) -> float:
    """Write a table downward from y; give where it ends."""
    sheet.text(x, y, title, fontsize=9, weight="bold")
    for number, row in enumerate(rows):
        y -= 4.6
        at = x
        for cell, width in zip(row, widths, strict=True):
            fits = int(width / 1.24)
            sheet.text(at, y, cell if len(cell) <= fits else cell[: fits - 1] + "…", fontsize=SMALL,
                       color=FAINT if number == 0 else INK)  # fmt: skip
            at += width
        if number == 0:
            sheet.plot([x, x + sum(widths)], [y - 1.2, y - 1.2], color=FAINT, lw=0.4)
    return y


def _title_block(sheet: Axes, kit: Kit, title: str, scale: float) -> None:
    width, height = SHEET_MM[0] - MARGIN_MM - COLUMN_X + 6.0, TITLE_HEIGHT
    x, y = SHEET_MM[0] - MARGIN_MM - width, MARGIN_MM
    sheet.add_patch(Rectangle((x, y), width, height, fc="white", ec=INK, lw=0.9))
    ratio = f"1 : {1 / scale:g}"
    sheet.text(x + 4, y + height - 8, title, fontsize=LARGE, weight="bold")
    lines = (
        f"Assembly. Millimetres. Scale {ratio} on A3. {kit.settings.scale_mm_per_m:g} mm per metre of simulation.",
        f"PLA at {kit.settings.infill:.0%} infill; about {kit.mass_g:.0f} g with servos and steel.",
        "Dashed: links, servo pockets and horn recesses. R: rods. Red: the range about rest.",
    )
    for number, line in enumerate(lines):
        sheet.text(x + 4, y + 13 - 5 * number, line, fontsize=SMALL)


def _dimension(sheet: Axes, a: Sequence[float], b: Sequence[float], text: str) -> None:
    sheet.annotate("", (a[0], a[1]), (b[0], b[1]), arrowprops=DIMENSION, zorder=8)
    slope = degrees(atan2(b[1] - a[1], b[0] - a[0]))
    upright = slope - 180.0 if slope > 90.0 else slope + 180.0 if slope <= -90.0 else slope
    sheet.text((a[0] + b[0]) / 2, (a[1] + b[1]) / 2, text, ha="center", va="center", rotation=upright, zorder=9,
               bbox={"boxstyle": "square,pad=0.2", "fc": "white", "ec": "none", "alpha": 0.85})  # fmt: skip


def _patch(shape: BaseGeometry, put: Any, **style: Any) -> PathPatch:
    rings = [ring for part in getattr(shape, "geoms", [shape]) for ring in (part.exterior, *part.interiors)]
    path = MplPath.make_compound_path(*(MplPath(put(ring.coords), closed=True) for ring in rings))
    return PathPatch(path, **style)
