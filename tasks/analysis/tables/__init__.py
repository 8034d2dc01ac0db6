"""Analyses. Each is one file in this folder, which registers the table that it makes."""

import importlib
import pkgutil

from tasks.analysis.registry import ANALYSES

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")  # an analysis registers itself when imported
