"""Robots into lanes: what does not change of them, and their state at the spawn, written to the rows of blocks.

In NumPy this is some hundred calls, a twentieth of the rollouts of 64 designs; compiled it is a hundredth.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from tasks.compiled import inline
from tasks.design.genes import N_LINKS
from tasks.simulation import rows
from tasks.simulation.contact import NO_VERTEX

Float32 = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int64]

HALF, QUARTER, ZERO, ONE = np.float32(0.5), np.float32(0.25), np.float32(0.0), np.float32(1.0)
THIRD = np.float32(1.0) / np.float32(3.0)


@inline
def inverse_mass_and_inertia(half_width: Any, half_height: Any, density: Any) -> Any:
    """b2PolygonShape::ComputeMass and b2Body::ResetMassData of a box, operation by operation in float32."""
    x, y = half_width, half_height
    corner_x, corner_y = (-x, x, x, -x), (-y, -y, y, y)
    area = inertia = ZERO * x
    for i in range(4):
        ex1, ey1, ex2, ey2 = corner_x[i], corner_y[i], corner_x[(i + 1) % 4], corner_y[(i + 1) % 4]
        D = ex1 * ey2 - ey1 * ex2
        area = area + HALF * D
        intx2 = ex1 * ex1 + ex2 * ex1 + ex2 * ex2
        inty2 = ey1 * ey1 + ey2 * ey1 + ey2 * ey2
        inertia = inertia + (QUARTER * THIRD * D) * (intx2 + inty2)
    return ONE / (density * area), ONE / (density * inertia)


def pack_robots(
    blocks: Float32, design_of_lane: Indices, order: Indices, place: Indices,
    parent: Indices, length_scale: npt.NDArray[np.float64],
    half_width: Float32, half_height: Float32, mass: Float32, inertia: Float32,
    parent_anchor: Float32, child_anchor: Float32, x: Float32, y: Float32, angle: Float32,
    frequency: Float32, phase_turns: Float32, motion_range: Float32, rest_angle: Float32,
    motor_on: npt.NDArray[np.bool_], density: np.float32, max_motor_impulse: np.float32,
) -> None:  # fmt: skip
    """Fill the lanes of blocks that are all 0: (n_groups, N_ROWS, n_lanes).

    A lane holds the robot of ``design_of_lane``: (n_groups · n_lanes,) indices. ``order`` is the link at each place in
    Box2D's island, ``place`` each link's place in it: (n_designs, n_links), as are the genes ``parent`` and
    ``length_scale`` [m] and the fields of :class:`tasks.design.KinematicTrees` and
    :class:`tasks.simulation.drive.Drive`, but ``frequency``, which is (n_designs, 1). ``density`` is that of every link
    [kg/m²], ``max_motor_impulse`` that of every motor that is on [N·m·s].
    """
    n_lanes = blocks.shape[2]
    for number in range(len(design_of_lane)):
        design, group, lane = design_of_lane[number], number // n_lanes, number % n_lanes
        robot = blocks[group, :, lane]
        robot[rows.FREQUENCY] = frequency[design, 0]
        for i in range(N_LINKS):
            link = order[design, i]
            length = np.float32(length_scale[design, link])
            inverse_mass, inverse_inertia = inverse_mass_and_inertia(
                half_width[design, link], half_height[design, link], density
            )
            robot[rows.X + i], robot[rows.Y + i] = x[design, link], y[design, link]
            robot[rows.ANGLE + i] = angle[design, link]
            robot[rows.HALF_WIDTH + i] = half_width[design, link]
            robot[rows.HALF_HEIGHT + i] = half_height[design, link]
            robot[rows.INVERSE_MASS + i], robot[rows.INVERSE_INERTIA + i] = inverse_mass, inverse_inertia
            robot[rows.LENGTH + i], robot[rows.WIDTH + i] = length, ONE / length
            robot[rows.MASS + i], robot[rows.INERTIA + i] = mass[design, link], inertia[design, link]
            robot[rows.VERTEX_1 + i] = robot[rows.VERTEX_2 + i] = NO_VERTEX
            if i > 0:
                j, above = i - 1, parent[design, link]
                inverse_mass, inverse_inertia = inverse_mass_and_inertia(
                    half_width[design, above], half_height[design, above], density
                )
                robot[rows.PARENT + j] = place[design, above]
                robot[rows.PARENT_INVERSE_MASS + j] = inverse_mass
                robot[rows.PARENT_INVERSE_INERTIA + j] = inverse_inertia
                robot[rows.PARENT_ANCHOR + j] = parent_anchor[design, link]
                robot[rows.CHILD_ANCHOR + j] = child_anchor[design, link]
                robot[rows.MAX_MOTOR_IMPULSE + j] = max_motor_impulse if motor_on[design, link] else ZERO
                robot[rows.PHASE + j] = phase_turns[design, link]
                robot[rows.MOTION_RANGE + j] = motion_range[design, link]
                robot[rows.REST_ANGLE + j] = rest_angle[design, link]
