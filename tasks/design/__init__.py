"""Designs of robots: genes, variation, and the bodies that they describe."""

from tasks.design.body import KinematicTrees, RigidBodies, kinematic_trees, rest_pose, rigid_bodies
from tasks.design.genes import GENES, N_LINKS, DesignError, Designs, check, concatenate
from tasks.design.morphology import ANY_BODY, Drawn, Morphology, links_apart
from tasks.design.variation import (
    Mutation,
    crossover,
    draw_mutants,
    draw_random,
    draw_recombinations,
    mutate,
    random_designs,
)

__all__ = [
    "ANY_BODY",
    "GENES",
    "N_LINKS",
    "DesignError",
    "Designs",
    "Drawn",
    "KinematicTrees",
    "Morphology",
    "Mutation",
    "RigidBodies",
    "check",
    "concatenate",
    "crossover",
    "draw_mutants",
    "draw_random",
    "draw_recombinations",
    "kinematic_trees",
    "links_apart",
    "mutate",
    "random_designs",
    "rest_pose",
    "rigid_bodies",
]
