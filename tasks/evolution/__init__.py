"""How designs get better: age-fitness Pareto optimisation, and what it is told to optimise."""

from tasks.evolution.afpo import EMPTY_POPULATION, OPERATORS, Afpo, Children, Population, ask, select, tell
from tasks.evolution.objective import Evaluation, evaluate, penalised_mean
from tasks.evolution.trial import HISTORY_UNITS, History, Trial, evolve

__all__ = [
    "EMPTY_POPULATION",
    "HISTORY_UNITS",
    "OPERATORS",
    "Afpo",
    "Children",
    "Evaluation",
    "History",
    "Population",
    "Trial",
    "ask",
    "evaluate",
    "evolve",
    "penalised_mean",
    "select",
    "tell",
]
