"""Hallucinated dynamics: where the members of an ensemble disagree.

All members learned from the same throws. Where throws were dense they agree and are right; where they disagree, most of
them are wrong, and evolution exploits a wrong one. None of this needs the true medium. Disagreement does not show an
error that all members share.

Entry i of a trace is the state after step i, so predictions from it belong to step i + 1.
"""

import numpy as np

from tasks.arrays import Float32, Float64, Floats
from tasks.design import Designs, kinematic_trees
from tasks.world import EnsembleMedium, LinkStates, Physics


def link_states(designs: Designs, trace: Floats, physics: Physics) -> LinkStates:
    """Return a trace, (n_designs, n_steps, n_links, 6) in the order of STATE, as the link states that a medium reads.

    They are (n_designs, n_steps, n_links) each, float32 like the trace.
    """
    trees = kinematic_trees(designs, density=physics.link_density)
    length_scale, mass, inertia = (
        np.broadcast_to(array.astype(trace.dtype)[:, None], trace.shape[:-1])
        for array in (designs.length_scale, trees.mass, trees.inertia)
    )
    _, y, angle, vx, vy, omega = np.moveaxis(trace, -1, 0)
    return LinkStates(length_scale, mass, inertia, y, np.cos(angle), np.sin(angle), vx, vy, omega)


def size(accelerations: Floats, links: LinkStates) -> Float64:
    """Return the root mean square of (..., 3) accelerations x, y, angle over a link's points: (...) [m/s²].

    A point r from the centre accelerates with a + α × r, whose mean square over the link is |a|² + α² I / m. So
    translation and rotation have one unit and are weighted as in kinetic energy.
    """
    ax, ay, alpha = np.moveaxis(np.asarray(accelerations, dtype=np.float64), -1, 0)
    return np.asarray(np.sqrt(ax * ax + ay * ay + alpha * alpha * (links.inertia / links.mass)), dtype=np.float64)


def disagreement(designs: Designs, trace: Floats, ensemble: EnsembleMedium, physics: Physics) -> Float32:
    """Return how two or more members disagree along rollouts, in whichever environment these were made.

    Args:
        designs: n_designs designs.
        trace: (n_designs, n_steps, n_links, 6) their states.
        ensemble: the members.
        physics: the base simulator's constants.

    Returns:
        (n_designs, n_steps, n_links) deviations over the members of the accelerations, by :func:`size` [m/s²].
    """
    links = link_states(designs, trace, physics)
    repeated = (np.broadcast_to(array, (ensemble.n_members, *array.shape)) for array in vars(links).values())
    change = ensemble.velocity_change(LinkStates(*repeated), physics)
    predicted = np.stack((change.vx, change.vy, change.omega), axis=-1).astype(np.float64) / physics.time_step
    return size(predicted.std(axis=0).astype(np.float32), links).astype(np.float32)
