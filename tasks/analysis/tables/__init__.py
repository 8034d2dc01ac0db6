"""Analyses. Each is one file in this folder, which registers the table that it makes."""

from tasks.analysis.registry import ANALYSES
from tasks.discovery import import_extensions

import_extensions(__name__, __path__)
