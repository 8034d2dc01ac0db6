"""Objectives of evolution. Each is one file in this folder, which registers it."""

from tasks.discovery import import_extensions
from tasks.evolution.objectives.evaluation import (
    OBJECTIVES,
    PAPERS_OBJECTIVE,
    Evaluation,
    Objective,
    ObjectiveName,
    disagreement,
    evaluate,
    penalised_mean,
    register_objective,
)

import_extensions(__name__, __path__)
