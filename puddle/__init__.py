"""puddle: evolve robots for a world whose physics the simulator lacks.

Designs, environments and the simulator, as arrays in memory::

    designs = puddle.random_designs(64, np.random.default_rng(seed=1))
    puddle.simulate(designs, puddle.TrueSlush(depth=9.0)).displacement

and what `puddle study` has recorded in a store::

    study = puddle.open_study("laptop", store="store")
    study.champions().to_pandas()
    study.table("histories", environment="true_slush", depth=9.0, trial=0)

Mistakes in arguments, and damage to a store, raise :class:`PuddleError`.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import sys
import warnings
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING


def _import_own(name: str) -> None:
    """Import a package beside this one, whatever a user's working folder has of that name."""
    init = Path(__file__).parents[1] / name / "__init__.py"
    other = getattr(sys.modules.get(name), "__file__", None)
    if name not in sys.modules:
        specification = importlib.util.spec_from_file_location(
            name, init, submodule_search_locations=[str(init.parent)]
        )
        assert specification is not None and specification.loader is not None
        sys.modules[name] = importlib.util.module_from_spec(specification)
        specification.loader.exec_module(sys.modules[name])
    elif other is None or Path(other).resolve() != init.resolve():
        raise ImportError(f"puddle has a package {name!r}, and {other} was imported before: import puddle first")


_import_own("tasks")
_import_own("pipeline")

from pipeline.errors import PuddleError
from tasks.design import Designs, crossover, mutate, random_designs
from tasks.simulation import simulate
from tasks.world import DryLand, RandomisedSlush, ResidualSlush, TrueSlush

if TYPE_CHECKING:
    from pipeline.results.recorded_study import Study

__all__ = [
    "Designs",
    "DryLand",
    "PuddleError",
    "RandomisedSlush",
    "ResidualSlush",
    "TrueSlush",
    "crossover",
    "mutate",
    "open_study",
    "random_designs",
    "simulate",
]

__version__ = importlib.metadata.version("puddle")


def open_study(name: str, store: str | Path = "store") -> Study:
    """Open a recorded study, to read its settings, progress, tables and champions.

    A study is what was recorded. Where today's code would make other results of its settings, a warning says so.

    Raises PuddleError if there is no such store or study (the message lists the studies there are), or if the study's
    record is damaged.
    """
    from pipeline.results import recorded_study  # imports what draws figures, which takes a second

    return recorded_study.open_study(name, store, say=partial(warnings.warn, stacklevel=3))
