"""puddle: evolve robots for a world whose physics the simulator lacks.

Designs, environments and the simulator, as arrays in memory::

    designs = puddle.random_designs(64, np.random.default_rng(seed=1))
    puddle.simulate(designs, puddle.TrueSlush(depth=9.0)).displacement

studies, run here or by `puddle study`, as a store records them::

    study = puddle.run_study("smoke", grid={"depths": [9.0]})
    study.champions().to_pandas()
    study.table("histories", environment="true_slush", depth=9.0, trial=0)

and networks that learn a medium from throws, without a study::

    ensemble = puddle.learn(puddle.throw("true_slush"))

Mistakes in arguments, and damage to a store, raise :class:`PuddleError`.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import sys
import warnings
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

_ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(_ROOT))  # ahead of a user's working folder, which may have a tasks.py or pipeline.py
import pipeline
import tasks

sys.path.remove(str(_ROOT))
for _package in (pipeline, tasks):
    if _ROOT not in Path(_package.__file__ or "/").resolve().parents:
        raise ImportError(f"puddle has a package {_package.__name__!r}, and another was imported: import puddle first")

from pipeline.errors import PuddleError
from tasks.design import GENES, Designs, crossover, mutate, random_designs
from tasks.residual import Architecture, Throws, Training
from tasks.residual.robot_tracks import record
from tasks.residual.throws import throw
from tasks.simulation import simulate
from tasks.world import DryLand, LinkStates, Physics, Pool, RandomisedSlush, ResidualSlush, TrueSlush, VelocityChange

if TYPE_CHECKING:
    from pipeline.results.film import film
    from pipeline.results.recorded_study import Study
    from pipeline.results.run_study import run_study
    from pipeline.store.design_file import load_design, open_designs, save_design
    from tasks.residual.training import learn

_LATER = {  # modules that import what reads studies, draws or trains, which takes seconds
    "film": "pipeline.results.film",
    "learn": "tasks.residual.training",
    "run_study": "pipeline.results.run_study",
    **dict.fromkeys(("load_design", "open_designs", "save_design"), "pipeline.store.design_file"),
}

__all__ = [
    "GENES",
    "Architecture",
    "Designs",
    "DryLand",
    "LinkStates",
    "Physics",
    "Pool",
    "PuddleError",
    "RandomisedSlush",
    "ResidualSlush",
    "Throws",
    "Training",
    "TrueSlush",
    "VelocityChange",
    "crossover",
    "film",
    "learn",
    "load_design",
    "mutate",
    "open_designs",
    "open_study",
    "random_designs",
    "record",
    "run_study",
    "save_design",
    "simulate",
    "throw",
]

__version__ = importlib.metadata.version("puddle")


def open_study(name: str, store: str | Path = "store") -> Study:
    """Open a recorded study, to read its settings, progress, tables and champions.

    A study is what was recorded. Where a different version of the code made it, a warning says so.

    >>> study = puddle.open_study("laptop")
    >>> study.champions().column_names[:5]
    ['environment', 'depth', 'trial', 'predicted', 'zero_shot']
    >>> histories = study.table("histories", environment="true_slush", depth=1.0, trial=0)
    >>> best = study.champion("residual_slush", depth=1.0, trial=1)
    >>> study.simulate(best, "true_slush").displacement.shape
    (1,)

    Raises PuddleError if there is no such store or study (the message lists the studies there are), or if the study's
    record is damaged.
    """
    from pipeline.results import recorded_study  # imports what draws figures, which takes a second

    return recorded_study.open_study(name, store, say=partial(warnings.warn, stacklevel=3))


def __dir__() -> list[str]:
    return sorted(["__doc__", "__version__", *__all__])


def __getattr__(name: str) -> Any:
    if name in _LATER:
        return getattr(importlib.import_module(_LATER[name]), name)
    raise AttributeError(f"module 'puddle' has no attribute {name!r}")
