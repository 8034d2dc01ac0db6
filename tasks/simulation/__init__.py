"""Simulation of designs in an environment, step by step."""

from tasks.simulation.conditions import Conditions
from tasks.simulation.rollout import DIVERGED, OK, Rollouts, simulate
