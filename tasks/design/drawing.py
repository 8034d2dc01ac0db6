"""Designs as drawings for a notebook: SVG of the robots at rest."""

import numpy as np

from tasks.design.body import rest_pose
from tasks.design.genes import Designs

_MOST = 12  # robots drawn
_SCALE = 20  # [pixel/m]
_INK = "#1d2129"


def drawn(designs: Designs) -> str:
    """Return HTML of valid designs: the first ones at rest, to one scale. A joint with a motor has a filled dot."""
    robots = ""
    for i in range(min(len(designs), _MOST)):
        design, links = designs[i].compact(), ""
        (places,), (length,) = np.stack(rest_pose(design), axis=-1), design.length_scale
        reach = np.hypot(length, 1 / length)[:, None] / 2
        low, high = (places[:, :2] - reach).min(axis=0), (places[:, :2] + reach).max(axis=0)
        for link, ((x, y, angle), a) in enumerate(zip(places, length, strict=True)):
            joint, fill = design.child_attachment[0, link] * a / 2, _INK if design.motor_on[0, link] else "#ffffff"
            links += f'<g transform="translate({x:.3f} {y:.3f}) rotate({np.degrees(angle):.2f})">'
            links += f'<rect x="{-0.5 / a:.3f}" y="{-a / 2:.3f}" width="{1 / a:.3f}" height="{a:.3f}" />'
            links += f'<circle cy="{joint:.3f}" r="0.12" fill="{fill}" /></g>' if link else "</g>"
        (left, _), (_, top), (width, height) = low, high, high - low
        robots += f'<svg width="{_SCALE * width:.0f}" viewBox="{left:.3f} {-top:.3f} {width:.3f} {height:.3f}">'
        robots += f'<g transform="scale(1 -1)" fill="#9aa5b4" stroke="{_INK}" stroke-width="0.05">{links}</g></svg>'
    return f"<div>{robots}{f' and {len(designs) - _MOST} more' if len(designs) > _MOST else ''}</div>"
