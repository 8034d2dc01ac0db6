"""Figures of the data set and of the networks that learned from it: paper, Fig. 2, and where each member is wrong."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pipeline.report.data import ENVIRONMENTS, StudyReport
from pipeline.report.drawing import FAINT, INK, WIDTH, NothingToDraw, count
from pipeline.report.findings import ThrownPaths

SIZES = (("o", "#dd7700"), ("s", "#1c6fb8"), ("^", "#7d4aa5"))
"""Marker and colour of the projectiles, short to long, as far as they go."""
VIEW = 24.0
"""How far the figure of the throws sees to either side [m]; throws that stay dry fly on."""
SHOWN_POINTS = 40
"""Points drawn of a throw's path."""


def data_set(report: StudyReport) -> tuple[Figure, str]:
    """Panels, one for each size of projectile: the paths of all throws, and one of them drawn as it turns."""
    throws = report.findings.throws
    if throws is None or len(throws.length_scale) == 0:
        raise NothingToDraw(report.findings.why("throws", "no link has been thrown yet, or the study needs none"))
    sizes = np.unique(throws.length_scale)
    figure = Figure(figsize=(WIDTH, 2.5 * len(sizes) + 0.5), layout="constrained")
    panels = figure.subplots(len(sizes), 1, sharex=True, sharey=True, squeeze=False).ravel()
    for number, (panel, size) in enumerate(zip(panels, sizes, strict=True)):
        of_size = throws.length_scale == size
        _paths(panel, throws, of_size, SIZES[number % len(SIZES)][1])
        panel.axhline(0, color=ENVIRONMENTS["true_slush"].color, lw=1.2)
        panel.set_title(f"{size:g} m × {1 / size:.2g} m, {of_size.sum()} throws", loc="left")
        panel.set_aspect("equal")
        panel.set_xlim(-VIEW, VIEW)
        panel.set_ylim(-8, 0.7 * VIEW)
        panel.set_ylabel("y [m]")
    panels[-1].set_xlabel("x [m]")
    return figure, (
        f"The {len(throws.length_scale)} throws that the networks learned from, {throws.seconds:.1f} s each: the way "
        "of each link’s centre, by its size. The blue line is the surface of the slush. One throw of each size is "
        f"drawn as it turns. The view ends {VIEW:g} m from the start; throws that stay dry fly on."
    )


def _paths(panel: Any, throws: ThrownPaths, chosen: Any, color: str) -> None:
    paths = throws.path[chosen]
    shown = np.unique(np.linspace(0, paths.shape[1] - 1, SHOWN_POINTS).round().astype(int))
    xy = paths[:, shown, :2]
    gap = np.full((len(xy), 1, 2), np.nan)  # lifts the pen between throws
    x, y = np.concatenate((xy, gap), axis=1).reshape(-1, 2).T
    panel.plot(x, y, color=color, lw=0.6, alpha=0.5)
    # Of those that stay in view, the one that goes furthest can be seen best.
    way = np.linalg.norm(np.diff(paths[:, :, :2], axis=1), axis=2).sum(axis=1)
    way[np.abs(paths[:, :, :2]).max(axis=(1, 2)) > 0.7 * VIEW] *= 1e-3
    length = float(throws.length_scale[chosen][0])
    poses = paths[int(np.argmax(way)), :: max(1, paths.shape[1] // 10)]
    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]) * (1 / length, length)
    cos, sin = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    turned = np.stack((cos * corners[:, 0] - sin * corners[:, 1], sin * corners[:, 0] + cos * corners[:, 1]), axis=-1)
    outlines = poses[:, None, :2] + turned
    panel.add_collection(PolyCollection(list(outlines), facecolors="none", edgecolors=INK, linewidths=0.9))


def member_error(report: StudyReport) -> tuple[Figure, str]:
    """Panels by velocity and immersion: each member's error along the champions' ways, by the link's speed."""
    rows = [
        row
        for row in report.findings.member_errors
        if row.rmse and row.rms_true is not None and row.band != "all" and row.immersion != "all"
    ]
    if not rows:
        raise NothingToDraw(report.findings.why("member_errors", "no member has been compared with True Slush yet"))
    components, bands, immersions = (
        list(dict.fromkeys(getattr(row, name) for row in rows)) for name in ("component", "band", "immersion")
    )
    members = sorted({row.member for row in rows})
    place = {band: index for index, band in enumerate(bands)}
    figure = Figure(figsize=(WIDTH, 1.75 * len(components) + 0.9), layout="constrained")
    grid = figure.subplots(len(components), len(immersions), sharex=True, sharey="row", squeeze=False)
    for (row_index, column), panel in np.ndenumerate(grid):
        chosen = [row for row in rows if (row.component, row.immersion) == (components[row_index], immersions[column])]
        for member in members:
            line = sorted((place[row.band], row.rmse) for row in chosen if row.member == member)
            if line:
                panel.plot(*zip(*line, strict=True), color=_RESIDUAL, marker="o", ms=3.2, lw=1.0, alpha=0.75)
        for index, true in sorted({(place[row.band], row.rms_true) for row in chosen}):
            if true:
                panel.plot([index - 0.3, index + 0.3], [true] * 2, color=INK, lw=2.0)
        panel.set_yscale("log")
        panel.grid(axis="y")
        panel.set_axisbelow(True)
        panel.set_xlim(-0.5, len(bands) - 0.5)
        panel.set_xticks(range(len(bands)), [band.replace("-", "–") for band in bands], fontsize=8, rotation=45)
        if row_index == 0:
            panel.set_title(immersions[column], loc="left")
        if column == 0:
            panel.set_ylabel(_ACCELERATION.get(components[row_index], components[row_index]))
    grid[-1, len(immersions) // 2].set_xlabel("speed of the link [m/s]")
    figure.legend(handles=_error_handles(), loc="outside lower center", ncols=2, handlelength=1.6, columnspacing=1.2)
    return figure, (
        "Root mean square error of the acceleration that each member predicts for the links of champions on their way "
        "through True Slush, by how much of the link is in the slush and by its speed. Dark bars are the accelerations "
        "themselves: the error of a network that predicts nothing; on a dry link they are zero, and all is imagined."
    )


_ACCELERATION = {"vx": "along x [m/s²]", "vy": "along y [m/s²]", "omega": "angular [rad/s²]"}
_RESIDUAL = ENVIRONMENTS["residual_slush"].color


def _error_handles() -> list[Line2D]:
    return [
        Line2D([], [], color=_RESIDUAL, marker="o", ms=4, lw=1.1, label="a member's error"),
        Line2D([], [], color=INK, lw=2.0, label="error of predicting nothing"),
    ]


def phantom_thrust(report: StudyReport) -> tuple[Figure, str]:
    """Draw a point with its interval for each member: the acceleration along x that it imagines at low speed."""
    found = [
        (member, thrust.value, thrust)
        for member, thrust in enumerate(report.findings.phantom_thrust)
        if thrust.value is not None
    ]
    if not found:
        reasons = [thrust.reason for thrust in report.findings.phantom_thrust if thrust.reason]
        raise NothingToDraw(
            report.findings.why(
                "phantom_thrust", reasons[0] if reasons else "no member has been tried at low speed yet"
            )
        )
    figure = Figure(figsize=(WIDTH, 0.28 * len(found) + 1.1), layout="constrained")
    axes = figure.add_subplot()
    axes.axvline(0, color=INK, lw=0.8)
    for row, (_, value, thrust) in enumerate(found):
        if thrust.low is not None and thrust.high is not None:
            axes.plot([thrust.low, thrust.high], [row, row], color=_RESIDUAL, lw=2.4)
        axes.plot(value, row, "o", color=_RESIDUAL, mec=INK, ms=5)
    axes.set_yticks(range(len(found)), [f"member {member}" for member, _, _ in found])
    axes.invert_yaxis()
    axes.grid(axis="x", color=FAINT)
    axes.set_axisbelow(True)
    axes.set_xlabel("imagined acceleration along x [m/s²]")
    return figure, (
        "Mean error of each member’s horizontal acceleration on held-out throws slower than 0.5 m/s, with its 95 % "
        "interval. Slush pushes nothing that is at rest to either side: to the right of 0 a robot that only floats is "
        "predicted to travel."
    )


def residual_error(report: StudyReport) -> tuple[Figure, str]:
    """Panels, one for each velocity: error on held-out throws over bands of speed, a line for each member.

    Only the velocities' residuals are applied to a robot, so positions are left out.
    """
    rows = [row for row in report.residual_errors if row.component in _VELOCITIES and row.rmse > 0]
    if not rows:
        raise NothingToDraw("no member of the residual ensemble has been validated yet, or the study needs none")
    components = list(dict.fromkeys((row.component, row.unit) for row in rows))
    bands = list(dict.fromkeys(row.speed_band for row in rows))
    members = sorted({row.member for row in rows})
    figure = Figure(figsize=(WIDTH, 1.75 * len(components) + 0.9), layout="constrained")
    panels = figure.subplots(len(components), 1, sharex=True, squeeze=False).ravel()
    place = {band: index for index, band in enumerate(bands)}
    for panel, (component, unit) in zip(panels, components, strict=True):
        chosen = [row for row in rows if row.component == component]
        for member in members:
            of_member = sorted((place[row.speed_band], row.rmse) for row in chosen if row.member == member)
            panel.plot(*zip(*of_member, strict=True), color=_RESIDUAL, marker="o", ms=4, lw=1.1, alpha=0.75)
        for index, residual in sorted({(place[row.speed_band], row.rms_residual) for row in chosen}):
            if residual > 0:
                panel.plot([index - 0.3, index + 0.3], [residual] * 2, color=INK, lw=2.0)
        panel.set_yscale("log")
        panel.set_ylabel(f"{component} [{unit}]")
        panel.grid(axis="y")
        panel.set_axisbelow(True)
    panels[-1].set_xticks(range(len(bands)), [band.removesuffix(" m/s").replace("-", "–") for band in bands])
    panels[-1].set_xlim(-0.5, len(bands) - 0.5)
    panels[-1].set_xlabel("speed of the thrown link [m/s]")
    figure.legend(handles=_error_handles(), loc="outside lower center", ncols=2, handlelength=1.6, columnspacing=1.2)
    return figure, (
        "Root mean square error of the change of velocity that a member predicts for a step, on throws that it never "
        f"saw, by the speed of the thrown link; {count(members, 'member')}. Dark bars are the changes themselves: "
        "the error of a network that predicts nothing."
    )


_VELOCITIES = ("vx", "vy", "omega")
