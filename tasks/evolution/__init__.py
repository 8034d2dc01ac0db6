"""How designs improve: age-fitness Pareto optimisation (AFPO), its objectives, and trials."""

from tasks.evolution.afpo import EMPTY_POPULATION, OPERATORS, Afpo, Population, ask, select, tell
from tasks.evolution.objectives import (
    OBJECTIVES,
    PAPERS_OBJECTIVE,
    Deviation,
    Evaluation,
    Objective,
    ObjectiveName,
    disagreement,
    evaluate,
    penalised_mean,
)
from tasks.evolution.trial import HISTORY_UNITS, History, Trial, evolve
