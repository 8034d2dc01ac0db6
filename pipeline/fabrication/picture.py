"""A shaded picture of the whole robot with dark edge lines, drawn with a depth buffer.

matplotlib sorts triangles by their centres, which fails where long rods pass between plates.
"""

import io
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from tasks.arrays import Float32, Float64, Int64
from tasks.fabrication.parts import Mesh

Colour = tuple[int, int, int]

_WIDTH_PX, _HEIGHT_PX = 1600, 1000
_OVERSAMPLING = 2  # along each axis, to smooth edges
_TO_EYE = np.array([0.55, 0.42, 0.72])  # ahead of the robot, above it and to its right
_EYE_DISTANCE = 4.0  # in radii of the robot
_LIGHTS = ((np.array([0.15, 0.9, 0.5]), 0.45), (np.array([0.35, 0.1, 0.9]), 0.35))  # directions and intensities
_AMBIENT = 0.42
_CREASE = 0.9  # cosine between neighbouring pixels' normals below which there is an edge
_DEPTH_STEP = 0.006  # between neighbouring pixels at an edge, in radii of the robot
_TEXT_COLOUR: Colour = (40, 44, 52)
_LINE_COLOUR: Colour = (58, 60, 66)
_PAPER: Colour = (250, 250, 248)


def picture(shown: Sequence[tuple[Mesh, Colour]], legend: Sequence[tuple[str, Colour]]) -> bytes:
    """Draw meshes, y up, with a legend of names and colours. Returns a PNG."""
    everything = np.concatenate([mesh.vertices for mesh, _ in shown])
    middle = (everything.min(axis=0) + everything.max(axis=0)) / 2
    radius = float(np.linalg.norm(everything - middle, axis=1).max())
    width, height = _WIDTH_PX * _OVERSAMPLING, _HEIGHT_PX * _OVERSAMPLING
    projected = [_projected((mesh.vertices - middle) / radius) for mesh, _ in shown]
    flat = np.concatenate(projected)[:, :2]
    low, high = flat.min(axis=0), flat.max(axis=0)
    scale = 0.88 * min(width / (high[0] - low[0]), (height - 90 * _OVERSAMPLING) / (high[1] - low[1]))
    centre = np.array([width / 2, (height - 70 * _OVERSAMPLING) / 2])
    corners, facing, colours, owner = [], [], [], []
    for index, ((mesh, colour), points) in enumerate(zip(shown, projected, strict=True)):
        xy = (points[:, :2] - (low + high) / 2) * np.array([scale, -scale]) + centre
        corners.append(np.column_stack([xy, points[:, 2]])[mesh.triangles])
        a, b, c = (mesh.vertices[mesh.triangles[:, corner]] for corner in range(3))
        across = np.cross(b - a, c - a)
        facing.append(across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12))
        colours.append(np.tile(np.array(colour, dtype=np.float64), (len(across), 1)))
        owner.append(np.full(len(across), index))
    depth, nearest = _nearest(np.concatenate(corners), width, height)
    image = _shaded(depth, nearest, np.concatenate(facing), np.concatenate(colours), np.concatenate(owner))
    small = Image.fromarray(image).resize((_WIDTH_PX, _HEIGHT_PX), Image.Resampling.BOX)
    _draw_legend(small, legend)
    buffer = io.BytesIO()
    small.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def _projected(points: Float64) -> Float64:
    """Project (n, 3) points to (n, 3) positions right and up in the picture, and depth from the eye."""
    back = _TO_EYE / np.linalg.norm(_TO_EYE)
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    seen = points @ np.array([right, up, back]).T
    away = _EYE_DISTANCE - seen[:, 2]
    return np.column_stack([seen[:, 0] / away, seen[:, 1] / away, away])


def _nearest(corners: Float64, width: int, height: int) -> tuple[Float32, npt.NDArray[np.int32]]:
    """Return the depth and the index of the nearest triangle at every pixel; infinity and -1 without one.

    ``corners`` is (n_triangles, 3, 3): x, y [px] and depth.
    """
    depth = np.full((height, width), np.inf, dtype=np.float32)
    nearest = np.full((height, width), -1, dtype=np.int32)
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    doubled = edge1[:, 0] * edge2[:, 1] - edge1[:, 1] * edge2[:, 0]
    low = np.maximum(np.ceil(corners[:, :, :2].min(axis=1) - 0.5).astype(int), 0)
    high = np.minimum(np.floor(corners[:, :, :2].max(axis=1) - 0.5).astype(int) + 1, [width, height])
    turned_here = (doubled < 0.0) & (high > low).all(axis=1)  # triangles that face the eye; y points down
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
    depth: Float32, nearest: npt.NDArray[np.int32], facing: Float64, colours: Float64, owner: Int64
) -> npt.NDArray[np.uint8]:
    """Colour every pixel by its triangle, with lines where mesh, depth or direction changes."""
    light = np.full(len(facing), _AMBIENT)
    for towards, brightness in _LIGHTS:
        light += brightness * np.clip(facing @ (towards / np.linalg.norm(towards)), 0.0, 1.0)
    palette = np.concatenate([colours * np.minimum(light, 1.0)[:, None], [_PAPER]]).astype(np.uint8)
    image = palette[nearest]  # -1 selects the last entry, the paper
    for first, second in (
        ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
        ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
    ):
        change = np.nonzero(nearest[first] != nearest[second])
        a, b = nearest[first][change], nearest[second][change]
        jump = np.abs(depth[first][change] - depth[second][change]) > _DEPTH_STEP  # the paper is infinitely far away
        line = jump | (owner[a] != owner[b]) | ((facing[a] * facing[b]).sum(axis=1) < _CREASE)
        at = tuple(axis[line] for axis in change)
        image[first][at] = _LINE_COLOUR
    return image


def _draw_legend(image: Image.Image, legend: Sequence[tuple[str, Colour]]) -> None:
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(size=22)
    x, y = 30, _HEIGHT_PX - 44
    for name, colour in legend:
        draw.rectangle((x, y, x + 24, y + 24), fill=colour, outline=_TEXT_COLOUR)
        draw.text((x + 34, y - 1), name, fill=_TEXT_COLOUR, font=font)
        x += 34 + int(draw.textlength(name, font=font)) + 36
