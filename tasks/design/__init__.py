"""What is evolved: designs, their variation, and the bodies that they describe."""

from tasks.design.body import KinematicTrees, RigidBodies, kinematic_trees, rest_pose, rigid_bodies
from tasks.design.genes import GENES, N_LINKS, DesignError, Designs, check, concatenate
from tasks.design.morphology import ANY_BODY, Morphology
from tasks.design.variation import Mutation, crossover, mutate, random_designs

__all__ = [
    "ANY_BODY",
    "GENES",
    "N_LINKS",
    "DesignError",
    "Designs",
    "KinematicTrees",
    "Morphology",
    "Mutation",
    "RigidBodies",
    "check",
    "concatenate",
    "crossover",
    "kinematic_trees",
    "mutate",
    "random_designs",
    "rest_pose",
    "rigid_bodies",
]
