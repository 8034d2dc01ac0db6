"""How designs improve: searches, age-fitness Pareto optimisation (AFPO) first; their objectives; and trials.

Each search is one file, which registers it; see :mod:`tasks.evolution.search`.
"""

from tasks.discovery import import_extensions
from tasks.evolution.afpo import Afpo, select
from tasks.evolution.breeding import OPERATORS
from tasks.evolution.objectives import (
    OBJECTIVES,
    PAPERS_OBJECTIVE,
    Evaluation,
    Objective,
    ObjectiveName,
    disagreement,
    evaluate,
    penalised_mean,
)
from tasks.evolution.search import (
    EMPTY_POPULATION,
    PAPERS_SEARCH,
    SEARCHES,
    Optimiser,
    Population,
    SearchName,
    empty_population,
    require_search,
)
from tasks.evolution.trial import History, Trial, evolve, history_units

import_extensions(__name__, __path__)
