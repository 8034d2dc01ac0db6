"""Figures of the data set and of the networks trained on it: paper, Fig. 2, and the errors of each member."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pipeline.report.data import StudyReport
from pipeline.report.drawing import FIGURE_WIDTH, INK, NothingToDraw, count, draw_interval, legend, sampled
from pipeline.report.findings import ThrowPaths
from tasks.analysis.member_error import MemberError
from tasks.arrays import Float64, Int64
from tasks.world import ENVIRONMENTS

_COLORS = ("#dd7700", "#1c6fb8", "#7d4aa5")
"""Colours of the projectiles, from short to long."""
_VIEW = 24.0  # distance shown to either side of the start of a throw [m]
_POINTS_PER_PATH = 40
_MOST_SIZES = 6  # panels of sizes
_RESIDUAL = ENVIRONMENTS["residual_slush"].color
_VELOCITIES = {"vx": "along x [m/s²]", "vy": "along y [m/s²]", "omega": "angular [rad/s²]"}
"""Components that are drawn, with the label of their acceleration. Residuals of positions are not applied to robots."""


def data_set(report: StudyReport) -> tuple[Figure, str]:
    """Draw a panel for each size of projectile: the paths of all throws, and the poses along one of them."""
    throws = report.findings.throws
    if throws is None or len(throws.length_scale) == 0:
        raise NothingToDraw(report.findings.why("throws", "no link has been thrown yet, or the study needs no throws"))
    titles, group = _sizes(throws.length_scale)
    figure = Figure(figsize=(FIGURE_WIDTH, 2.5 * len(titles) + 0.5), layout="constrained")
    panels = figure.subplots(len(titles), 1, sharex=True, sharey=True, squeeze=False).ravel()
    for number, (panel, title) in enumerate(zip(panels, titles, strict=True)):
        of_size = group == number
        _paths(panel, throws, of_size, _COLORS[number % len(_COLORS)])
        panel.axhline(0, color=ENVIRONMENTS["true_slush"].color, lw=1.2)
        panel.set_title(f"{title}, {of_size.sum():,} throws")
        panel.set(aspect="equal", xlim=(-_VIEW, _VIEW), ylim=(-8, 0.7 * _VIEW), ylabel="y [m]")
    panels[-1].set_xlabel("x [m]")
    n_transitions = int(np.isfinite(throws.path[..., 0]).sum())
    return figure, (
        f"The {len(throws.length_scale):,} throws of {throws.seconds:.1f} s, {n_transitions:,} transitions: paths of "
        f"the link’s centre, by the size of the link. {_learned_from(throws)} The blue line is the surface of the "
        f"slush. For one throw of each size the link is drawn along its path. The view ends {_VIEW:g} m from the "
        "start; throws that miss the slush fly farther."
    )


def _sizes(length_scale: Float64) -> tuple[list[str], Int64]:
    """Group (n_throws,) links by size, or by thirds of the range where there are many; return titles and groups."""
    sizes, group = np.unique(length_scale, return_inverse=True)
    if len(sizes) <= _MOST_SIZES:
        return [f"{size:g} m × {1 / size:.2g} m" for size in sizes], group
    edges = np.linspace(sizes[0], sizes[-1], 4)
    titles = [f"{low:.1f} to {high:.1f} m long" for low, high in pairwise(edges)]
    return titles, np.searchsorted(edges[1:-1], length_scale)


def _learned_from(throws: ThrowPaths) -> str:
    n_held_out = len(throws.length_scale) - throws.n_learned
    if n_held_out == 0:
        return "The networks were trained on all of them."
    return f"The networks were trained on {throws.n_learned} of them; the other {n_held_out} were held out."


def _validated_on(report: StudyReport) -> str:
    throws = report.findings.throws
    every = throws is not None and throws.n_learned == len(throws.length_scale)
    return "the throws that it was trained on" if every else "held-out throws"


def _paths(panel: Any, throws: ThrowPaths, chosen: Any, color: str) -> None:
    paths = throws.path[chosen]
    xy = paths[:, sampled(paths.shape[1], _POINTS_PER_PATH), :2]
    gap = np.full((len(xy), 1, 2), np.nan)  # lifts the pen between throws
    x, y = np.concatenate((xy, gap), axis=1).reshape(-1, 2).T
    panel.plot(x, y, color=color, lw=0.6, alpha=0.5)
    # The throw drawn with its poses is the longest path among those that stay in view.
    path_length = np.nansum(np.linalg.norm(np.diff(paths[:, :, :2], axis=1), axis=2), axis=1)
    path_length[(np.abs(paths[:, :, :2]) > 0.7 * _VIEW).any(axis=(1, 2))] *= 1e-3
    length = float(throws.length_scale[chosen][0])
    poses = paths[int(np.argmax(path_length)), :: max(1, paths.shape[1] // 10)]
    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]) * (1 / length, length)
    cos, sin = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    turned = np.stack((cos * corners[:, 0] - sin * corners[:, 1], sin * corners[:, 0] + cos * corners[:, 1]), axis=-1)
    outlines = poses[:, None, :2] + turned
    panel.add_collection(PolyCollection(list(outlines), facecolors="none", edgecolors=INK, linewidths=0.9))


def member_error(report: StudyReport) -> tuple[Figure, str]:
    """Draw panels by velocity and immersion: each member's error along the champions' paths, by speed of the link."""
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
    figure = Figure(figsize=(FIGURE_WIDTH, 1.75 * len(components) + 0.9), layout="constrained")
    grid = figure.subplots(len(components), len(immersions), sharex=True, sharey="row", squeeze=False)
    for (i, j), panel in np.ndenumerate(grid):
        chosen = [row for row in rows if (row.component, row.immersion) == (components[i], immersions[j])]
        _errors_by_speed(panel, bands, chosen)
        panel.set_xticks(range(len(bands)), [band.replace("-", "–") for band in bands], fontsize=8, rotation=45)
    for panel, immersion in zip(grid[0], immersions, strict=True):
        panel.set_title(immersion)
    for panel, component in zip(grid[:, 0], components, strict=True):
        panel.set_ylabel(_VELOCITIES.get(component, component))
    grid[-1, len(immersions) // 2].set_xlabel("speed of the link [m/s]")
    legend(figure, _error_handles())
    return figure, (
        "Root mean square error of the accelerations that each member predicts for the links of champions moving "
        "through True Slush, by how much of the link is submerged and by its speed. Dark bars are the accelerations "
        "themselves, which is the error of predicting zero. A dry link has none, so any prediction is hallucinated."
    )


def residual_error(report: StudyReport) -> tuple[Figure, str]:
    """Draw a panel for each velocity: error of each member on held-out throws, by speed of the link."""
    rows = [row for row in report.residual_errors if row.component in _VELOCITIES and row.rmse]
    if not rows:
        raise NothingToDraw("no member of the ensemble has been validated yet, or the study needs no networks")
    components, bands = (list(dict.fromkeys(getattr(row, name) for row in rows)) for name in ("component", "band"))
    figure = Figure(figsize=(FIGURE_WIDTH, 1.75 * len(components) + 0.9), layout="constrained")
    panels = figure.subplots(len(components), 1, sharex=True, squeeze=False).ravel()
    for panel, component in zip(panels, components, strict=True):
        _errors_by_speed(panel, bands, [row for row in rows if row.component == component])
        panel.set_ylabel(f"{component} [{'rad/s' if component == 'omega' else 'm/s'}]")
    panels[-1].set_xticks(range(len(bands)), [band.replace("-", "–") for band in bands])
    panels[-1].set_xlabel("speed of the thrown link [m/s]")
    legend(figure, _error_handles())
    return figure, (
        "Root mean square error of the change of velocity per step that a member predicts, on "
        f"{_validated_on(report)}, by the speed of the thrown link; "
        f"{count({row.member for row in rows}, 'member')}. Dark bars are the changes themselves, which is the error of "
        "predicting zero."
    )


def _errors_by_speed(panel: Any, bands: list[str], rows: Sequence[MemberError]) -> None:
    """Draw a line per member, and a bar per band for the true values."""
    for member in sorted({row.member for row in rows}):
        line = sorted((bands.index(row.band), row.rmse) for row in rows if row.member == member and row.rmse)
        panel.plot(*zip(*line, strict=True), color=_RESIDUAL, marker="o", ms=3.5, lw=1.1, alpha=0.75)
    for index, true in sorted({bands.index(row.band): row.rms_true for row in rows if row.rms_true}.items()):
        panel.plot([index - 0.3, index + 0.3], [true] * 2, color=INK, lw=2.0)
    panel.set_yscale("log")
    panel.grid(axis="y")
    panel.set_xlim(-0.5, len(bands) - 0.5)


def _error_handles() -> list[Line2D]:
    return [
        Line2D([], [], color=_RESIDUAL, marker="o", ms=4, lw=1.1, label="error of a member"),
        Line2D([], [], color=INK, lw=2.0, label="error of predicting zero"),
    ]


def phantom_thrust(report: StudyReport) -> tuple[Figure, str]:
    """Draw the horizontal acceleration that each member hallucinates at low speed, with its interval."""
    thrusts = report.findings.phantom_thrust
    found = [(member, thrust) for member, thrust in enumerate(thrusts) if thrust.value is not None]
    if not found:
        reasons = (thrust.reason for thrust in thrusts if thrust.reason)
        reason = next(reasons, "no member has been tested at low speed yet")
        raise NothingToDraw(report.findings.why("phantom_thrust", reason))
    figure = Figure(figsize=(FIGURE_WIDTH, 0.28 * len(found) + 1.1), layout="constrained")
    axes = figure.add_subplot()
    axes.axvline(0, color=INK, lw=0.8)
    for row, (_, thrust) in enumerate(found):
        draw_interval(axes, row, thrust, _RESIDUAL)
    axes.set_yticks(range(len(found)), [f"member {member}" for member, _ in found])
    axes.invert_yaxis()
    axes.grid(axis="x")
    axes.set_xlabel("hallucinated acceleration along x [m/s²]")
    return figure, (
        f"Mean error of each member’s horizontal acceleration on {_validated_on(report)}, slower than 0.5 m/s, with "
        "its 95 % interval. Slush does not push a resting link sideways. With an error above 0, a robot that only "
        "floats is predicted to travel to the right."
    )
