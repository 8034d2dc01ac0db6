"""A picture of the whole robot: triangles on a depth buffer, shaded, with dark lines along edges as in CAD.

matplotlib sorts triangles by their middles, which fails where long rods pass between plates; a depth buffer does not.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from tasks.arrays import Float64
from tasks.fabrication.parts import Mesh

Colour = tuple[int, int, int]

WIDTH, HEIGHT = 1600, 1000
"""Of the picture [pixels]."""
_OVERSAMPLING = 2
"""Along each axis; edges are smoothed so."""
TOWARDS_EYE = np.array([0.55, 0.42, 0.72])
"""From the robot: ahead of it, above it and to its right."""
DISTANCE = 4.0
"""Of the eye, in radii of the robot."""
LIGHTS = ((np.array([0.15, 0.9, 0.5]), 0.45), (np.array([0.35, 0.1, 0.9]), 0.35))
"""Directions to them, and how bright."""
AMBIENT = 0.42
CREASE = 0.9
"""Cosine between neighbouring pixels' normals below which there is an edge."""
JUMP = 0.006
"""Difference of depth between neighbouring pixels at which there is an edge, in radii of the robot."""
INK: Colour = (40, 44, 52)
LINE: Colour = (58, 60, 66)
_PAPER: Colour = (250, 250, 248)


@dataclass(frozen=True, eq=False)
class ColouredMesh:
    """A mesh and its colour."""

    mesh: Mesh
    colour: Colour


def picture(shown: Sequence[ColouredMesh], legend: Sequence[tuple[str, Colour]]) -> bytes:
    """Draw meshes as PNG.

    Args:
        shown: what is there; y is up.
        legend: names and colours to explain.
    """
    everything = np.concatenate([s.mesh.vertices for s in shown])
    middle = (everything.min(axis=0) + everything.max(axis=0)) / 2
    radius = float(np.linalg.norm(everything - middle, axis=1).max())
    width, height = WIDTH * _OVERSAMPLING, HEIGHT * _OVERSAMPLING
    projected = [_projected((s.mesh.vertices - middle) / radius) for s in shown]
    flat = np.concatenate(projected)[:, :2]
    low, high = flat.min(axis=0), flat.max(axis=0)
    scale = 0.88 * min(width / (high[0] - low[0]), (height - 90 * _OVERSAMPLING) / (high[1] - low[1]))
    centre = np.array([width / 2, (height - 70 * _OVERSAMPLING) / 2])
    corners, facing, colours, owner = [], [], [], []
    for index, (item, points) in enumerate(zip(shown, projected, strict=True)):
        xy = (points[:, :2] - (low + high) / 2) * np.array([scale, -scale]) + centre
        corners.append(np.column_stack([xy, points[:, 2]])[item.mesh.triangles])
        a, b, c = (item.mesh.vertices[item.mesh.triangles[:, corner]] for corner in range(3))
        across = np.cross(b - a, c - a)
        facing.append(across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12))
        colours.append(np.tile(np.array(item.colour, dtype=np.float64), (len(across), 1)))
        owner.append(np.full(len(across), index))
    depth, nearest = _nearest(np.concatenate(corners), width, height)
    image = _shaded(depth, nearest, np.concatenate(facing), np.concatenate(colours), np.concatenate(owner))
    small = Image.fromarray(image).resize((WIDTH, HEIGHT), Image.Resampling.BOX)
    _explain(small, legend)
    buffer = io.BytesIO()
    small.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def _projected(points: Float64) -> Float64:
    """Give the place on the picture, right and up, and the depth from the eye. (n, 3) to (n, 3)."""
    back = TOWARDS_EYE / np.linalg.norm(TOWARDS_EYE)
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    seen = points @ np.array([right, up, back]).T
    away = DISTANCE - seen[:, 2]
    return np.column_stack([seen[:, 0] / away, seen[:, 1] / away, away])


def _nearest(corners: Float64, width: int, height: int) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int32]]:
    """Find the depth and the index of the nearest triangle at every pixel; infinite and -1 where there is none.

    Args:
        corners: (n_triangles, 3, 3) of x, y [pixels] and depth.
        width: of the picture.
        height: of the picture.
    """
    depth = np.full((height, width), np.inf, dtype=np.float32)
    nearest = np.full((height, width), -1, dtype=np.int32)
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    doubled = edge1[:, 0] * edge2[:, 1] - edge1[:, 1] * edge2[:, 0]
    low = np.maximum(np.ceil(corners[:, :, :2].min(axis=1) - 0.5).astype(int), 0)
    high = np.minimum(np.floor(corners[:, :, :2].max(axis=1) - 0.5).astype(int) + 1, [width, height])
    turned_here = (doubled < 0.0) & (high > low).all(axis=1)  # y runs down the picture
    for t in np.flatnonzero(turned_here):
        (x0, y0), (x1, y1) = low[t], high[t]
        px = np.arange(x0, x1) + 0.5 - corners[t, 0, 0]
        py = (np.arange(y0, y1) + 0.5 - corners[t, 0, 1])[:, None]
        v = (px * edge2[t, 1] - py * edge2[t, 0]) / doubled[t]
        w = (py * edge1[t, 0] - px * edge1[t, 1]) / doubled[t]
        here = corners[t, 0, 2] + v * edge1[t, 2] + w * edge2[t, 2]
        window = (slice(y0, y1), slice(x0, x1))
        nearer = (v >= 0.0) & (w >= 0.0) & (v + w <= 1.0) & (here < depth[window])
        depth[window][nearer] = here[nearer]
        nearest[window][nearer] = t
    return depth, nearest


def _shaded(
    depth: npt.NDArray[np.float32],
    nearest: npt.NDArray[np.int32],
    facing: Float64,
    colours: Float64,
    owner: npt.NDArray[np.int64],
) -> npt.NDArray[np.uint8]:
    """Colour every pixel by its triangle, and draw a line where thing, depth or direction changes."""
    light = np.full(len(facing), AMBIENT)
    for towards, brightness in LIGHTS:
        light += brightness * np.clip(facing @ (towards / np.linalg.norm(towards)), 0.0, 1.0)
    palette = np.concatenate([colours * np.minimum(light, 1.0)[:, None], [_PAPER]]).astype(np.uint8)
    image = palette[nearest]  # -1 is the last: paper
    for first, second in (
        ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
        ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
    ):
        change = np.nonzero(nearest[first] != nearest[second])
        a, b = nearest[first][change], nearest[second][change]
        jump = np.abs(depth[first][change] - depth[second][change]) > JUMP  # paper is infinitely far
        line = jump | (owner[a] != owner[b]) | ((facing[a] * facing[b]).sum(axis=1) < CREASE)
        at = tuple(axis[line] for axis in change)
        image[first][at] = LINE
    return image


def _explain(image: Image.Image, legend: Sequence[tuple[str, Colour]]) -> None:
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(size=22)
    x, y = 30, HEIGHT - 44
    for name, colour in legend:
        draw.rectangle((x, y, x + 24, y + 24), fill=colour, outline=INK)
        draw.text((x + 34, y - 1), name, fill=INK, font=font)
        x += 34 + int(draw.textlength(name, font=font)) + 36
