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
from tasks.simulation import simulate
from tasks.world import DryLand, LinkStates, Physics, Pool, RandomisedSlush, ResidualSlush, TrueSlush, VelocityChange

if TYPE_CHECKING:
    from pipeline.results.film import film
    from pipeline.results.recorded_study import Study

__all__ = [
    "GENES",
    "Designs",
    "DryLand",
    "LinkStates",
    "Physics",
    "Pool",
    "PuddleError",
    "RandomisedSlush",
    "ResidualSlush",
    "TrueSlush",
    "VelocityChange",
    "crossover",
    "film",
    "load_design",
    "mutate",
    "open_designs",
    "open_study",
    "random_designs",
    "save_design",
    "simulate",
]

__version__ = importlib.metadata.version("puddle")


def open_study(name: str, store: str | Path = "store") -> Study:
    """Open a recorded study, to read its settings, progress, tables and champions.

    A study is what was recorded. Where a different version of the code made it, a warning says so.

    Raises PuddleError if there is no such store or study (the message lists the studies there are), or if the study's
    record is damaged.
    """
    from pipeline.results import recorded_study  # imports what draws figures, which takes a second

    return recorded_study.open_study(name, store, say=partial(warnings.warn, stacklevel=3))


def load_design(path: str | Path) -> Designs:
    """Read a design file, such as those of `puddle export`; raise PuddleError if it is none."""
    from pipeline.store.design_file import read_design

    return read_design(Path(path))


def open_designs(path: str | Path) -> Designs:
    """Read the designs of a table, such as docs/champions.parquet; raise PuddleError if it holds none."""
    from pipeline.store.design_file import read_designs

    return read_designs(Path(path))


def save_design(design: Designs, path: str | Path) -> None:
    """Write one design to a file that every command takes; raise PuddleError if it is not one valid design."""
    from pipeline.store.design_file import write_design

    write_design(design, Path(path))


def __getattr__(name: str) -> Any:
    if name == "film":
        from pipeline.results.film import film  # imports what draws, which takes a second

        return film
    raise AttributeError(f"module 'puddle' has no attribute {name!r}")
