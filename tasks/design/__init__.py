"""Designs of robots: genes, variation, and the bodies that they describe."""

from tasks.design.body import RigidBodies, kinematic_trees, rest_pose, rigid_bodies
from tasks.design.controllers import CONTROLLERS, OPEN_LOOP
from tasks.design.gene import GENES, DesignError
from tasks.design.genes import MOST_LINKS, N_LINKS, Designs, check
from tasks.design.morphology import ANY_BODY, LinkLimits, Morphology, MorphologyRules, links_apart
from tasks.design.variation import Mutation, crossover, jittered, motors_off, mutate, random_designs
