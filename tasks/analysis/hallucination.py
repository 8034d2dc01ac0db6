"""Hallucinated dynamics: where the members of an ensemble disagree.

All members learned from the same throws. Where throws were dense they agree and are right; where they disagree, most of
them are wrong, and evolution exploits a wrong one. None of this needs the true medium. Disagreement does not show an
error that all members share.

Entry i of a trace is the state after step i, so predictions from it belong to step i + 1.
"""

import numpy as np

from tasks.arrays import Float32, Float64, Floats
from tasks.design import Designs, kinematic_trees
from tasks.world import EnsembleMedium, LinkStates, Medium, Physics


def link_states(designs: Designs, trace: Floats, physics: Physics) -> LinkStates:
    """Return a trace as the link states that a medium reads: (..., n_designs, n_steps, n_links), float32 like it.

    Args:
        designs: n_designs designs.
        trace: (..., n_designs, n_steps, n_links, 6) in the order of STATE, as in :class:`Rollouts`.
        physics: the base simulator's constants.
    """
    trees = kinematic_trees(designs, density=physics.link_density)
    shape = trace.shape[:-1]
    length_scale, mass, inertia = (
        np.broadcast_to(array.astype(trace.dtype)[:, None], shape)
        for array in (designs.length_scale, trees.mass, trees.inertia)
    )
    _, y, angle, vx, vy, omega = np.moveaxis(trace, -1, 0)
    return LinkStates(length_scale, mass, inertia, y, np.cos(angle), np.sin(angle), vx, vy, omega)


def acceleration(medium: Medium, links: LinkStates, physics: Physics) -> Float64:
    """Return a medium's mean accelerations over a step: (..., 3) of x, y [m/s²] and angle [rad/s²].

    Args:
        medium: the medium.
        links: link states of shape (...).
        physics: the base simulator's constants.
    """
    change = medium.velocity_change(links, physics)
    return np.stack((change.vx, change.vy, change.omega), axis=-1).astype(np.float64) / physics.time_step


def size(accelerations: Floats, links: LinkStates) -> Float64:
    """Return the root mean square of (..., 3) accelerations over a link's points: (...) [m/s²].

    A point r from the centre accelerates with a + α × r, whose mean square over the link is |a|² + α² I / m. So
    translation and rotation have one unit and are weighted as in kinetic energy.
    """
    ax, ay, alpha = np.moveaxis(np.asarray(accelerations, dtype=np.float64), -1, 0)
    return np.asarray(np.sqrt(ax * ax + ay * ay + alpha * alpha * (links.inertia / links.mass)), dtype=np.float64)


def predicted_accelerations(
    designs: Designs, trace: Floats, ensemble: EnsembleMedium, physics: Physics
) -> tuple[Float64, LinkStates]:
    """Return what each member predicts along rollouts, and the links' states.

    Args:
        designs: n_designs designs.
        trace: (n_designs, n_steps, n_links, 6) states in True Slush or with one member.
        ensemble: n_members members.
        physics: the base simulator's constants.

    Returns:
        (n_members, n_designs, n_steps, n_links, 3) accelerations, and link states without the first axis.
    """
    links = link_states(designs, trace, physics)
    repeated = (np.broadcast_to(array, (ensemble.n_members, *array.shape)) for array in vars(links).values())
    return acceleration(ensemble, LinkStates(*repeated), physics), links


def disagreement(designs: Designs, trace: Floats, ensemble: EnsembleMedium, physics: Physics) -> Float32:
    """Return how the members disagree along rollouts, in whichever environment these were made.

    Arguments are those of :func:`predicted_accelerations`. Returns (n_designs, n_steps, n_links) deviations over two or
    more members, by :func:`size` [m/s²].
    """
    predicted, links = predicted_accelerations(designs, trace, ensemble, physics)
    return size(predicted.std(axis=0).astype(np.float32), links).astype(np.float32)
