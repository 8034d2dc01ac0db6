"""How designs improve: searches, age-fitness Pareto optimisation (AFPO) first; their objectives; and trials.

Each search is one file, which registers it; see :mod:`tasks.evolution.search`.
"""

import importlib
import pkgutil

from tasks.evolution.afpo import Afpo, select
from tasks.evolution.breeding import OPERATORS
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
from tasks.evolution.search import (
    EMPTY_POPULATION,
    PAPERS_SEARCH,
    SEARCHES,
    Children,
    Optimiser,
    Population,
    Search,
    SearchName,
    register_search,
    require_search,
)
from tasks.evolution.trial import History, Trial, evolve, history_units

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")  # a search registers itself when imported
