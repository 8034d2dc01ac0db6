"""Scores of a table of designs in one environment."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from pipeline.commands.trained_networks import trained_networks
from pipeline.config.settings import DEEPEST, Settings
from pipeline.errors import PuddleError
from pipeline.stages import environments
from pipeline.store import disk
from pipeline.store.design_table import read_designs
from pipeline.store.encoding import encode_table
from pipeline.store.store import Store
from pipeline.store.tables import Columns, csv_of
from pipeline.workflow.stage import Execution
from tasks.evolution import OBJECTIVES
from tasks.world import ENVIRONMENTS

_ENVIRONMENTS = tuple(name for name, kind in ENVIRONMENTS.items() if kind.networks != "one")
_AT_ONCE = 4096  # designs simulated in one call, to bound the memory
_UNITS = {
    "design": "row of the table, from 0",
    "diverged": "",
    "displacement": "m, of the root; of each member",
    "com_displacement": "m, of the centre of mass; of each member",
}


def score_designs(
    path: Path, environment: str, depth: float, out: Path | None, *, settings: Settings, open_store: Callable[[], Store]
) -> Iterator[str]:
    """Score the designs of a table; yield lines that summarise the scores.

    Args:
        path: the table of designs; see :func:`pipeline.store.design_table.read_designs`.
        environment: dry_land, true_slush, residual_slush, or another registered one.
        depth: depth of the ground below the surface [m], 0 to DEEPEST.
        out: the Parquet or CSV file to write, if any.
        settings: they choose the length of the rollout, and the networks of environments that need them.
        open_store: opens the store that holds the networks.

    Raises:
        PuddleError: an argument is invalid, networks are missing, or a file can't be read or written.
    """
    if environment not in _ENVIRONMENTS:
        raise PuddleError(f"--environment: expected one of {', '.join(_ENVIRONMENTS)}, got {environment!r}")
    if not 0.0 <= depth <= DEEPEST:
        raise PuddleError(f"--depth: expected 0 to {DEEPEST:g} m, got {depth:g}")
    if out is not None and (out.suffix not in (".parquet", ".csv") or not out.parent.is_dir() or out.is_dir()):
        raise PuddleError(
            f"--out: expected a file name that ends in .parquet or .csv, in an existing folder, got {out}"
        )
    designs = read_designs(path)
    needs_networks = ENVIRONMENTS[environment].networks == "all"
    networks = trained_networks(settings, open_store, environment) if needs_networks else {}
    simulation = environments.simulation_spec(settings, environment)
    at = environments.build_environment(simulation.media, environment, depth, networks)
    execution, fitness = Execution(settings.work.engine), environments.fitness_spec(settings, environment)
    columns: list[Columns] = []
    for first in range(0, len(designs), _AT_ONCE):
        scores = environments.evaluate_designs(designs[first : first + _AT_ONCE], simulation, execution, at, fitness)
        columns.append(
            {
                "diverged": np.isneginf(scores.fitness),
                "fitness": scores.fitness,
                "displacement": scores.displacement if at.is_ensemble else scores.displacement[:, 0],
                "com_displacement": scores.com_displacement if at.is_ensemble else scores.com_displacement[:, 0],
            }
        )
    table = {name: np.concatenate([part[name] for part in columns]) for name in columns[0]}
    table = {"design": np.arange(len(designs)), **table}
    label, n_diverged = ENVIRONMENTS[environment].label, int(table["diverged"].sum())
    yield f"{label}, {depth:g} m deep: {len(designs)} design{'s' * (len(designs) != 1)}, {n_diverged} diverged"
    objective = OBJECTIVES[settings.evolution.objective]
    unit = objective.unit
    finite = table["fitness"][~table["diverged"]]
    if len(finite):
        best = int(np.argmax(table["fitness"]))
        mean, median = (f"{value:z.2f} {unit}" for value in (finite.mean(), np.median(finite)))
        yield f"  fitness ({objective.label.lower()}): mean {mean}, median {median}"
        yield f"  best: design {best}, {finite.max():z.2f} {unit}"
    if out is not None:
        content = encode_table(table, schema="scores", version=1, producer=str(path), units={**_UNITS, "fitness": unit})
        with disk.explained("writing scores", out, advice="choose another file"):
            out.write_bytes(content if out.suffix == ".parquet" else csv_of(table))
        yield f"  scores in {out}"
