"""Objectives of evolution. Each is one file in this folder, which registers it."""

import importlib
import pkgutil

from tasks.evolution.objectives.evaluation import (
    OBJECTIVES,
    PAPERS_OBJECTIVE,
    Deviation,
    Evaluation,
    Objective,
    ObjectiveName,
    disagreement,
    evaluate,
    penalised_mean,
    register_objective,
)

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")  # an objective registers itself when imported
