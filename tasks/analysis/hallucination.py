"""Hallucinated dynamics: where the members of an ensemble disagree.

All members learned from the same throws. Where throws were dense they agree and are right; where they disagree, most of
them are wrong, and evolution exploits a wrong one. None of this needs the true medium. Disagreement does not show an
error that all members share.

Entry i of a trace is the state after step i, so predictions from it belong to step i + 1.
"""

import numpy as np

from tasks.arrays import Float32, Floats
from tasks.design import Designs
from tasks.simulation.scenes import links_along
from tasks.world import EnsembleMedium, LinkStates, Physics


def disagreement_along(designs: Designs, trace: Floats, ensemble: EnsembleMedium, physics: Physics) -> Float32:
    """Return how two or more members disagree along rollouts, in whichever environment these were made.

    A point r from a link's centre accelerates with a + α × r, whose mean square over the link is |a|² + α² I / m. So
    translation and rotation have one unit and are weighted as in kinetic energy.

    Args:
        designs, trace: n_designs designs, and (n_designs, n_steps, n_links, 6) their states, in the order of STATE.
        ensemble, physics: the members, and the base simulator's constants.

    Returns:
        (n_designs, n_steps, n_links) deviations over the members [m/s²].
    """
    along = vars(links_along(designs, trace, physics))
    shape = (ensemble.n_members, *trace.shape[:-1])
    links = LinkStates(**{name: np.broadcast_to(array, shape) for name, array in along.items()})
    change = ensemble.velocity_change(links, physics)
    predicted = np.stack((change.vx, change.vy, change.omega)).astype(np.float64) / physics.time_step
    ax, ay, alpha = predicted.std(axis=1).astype(np.float32).astype(np.float64)
    gyration = links.inertia[0] / links.mass[0]
    deviation: Float32 = np.sqrt(ax * ax + ay * ay + alpha * alpha * gyration).astype(np.float32)
    return deviation
