"""puddle score: how far many designs get in one environment."""

import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from pipeline.commands.chosen_environment import (
    DepthOption,
    EngineOption,
    EnvironmentOption,
    checked_environment,
    required_networks,
)
from pipeline.commands.options import SettingsOptions, output_suffix, with_options
from pipeline.commands.terminal import to_stdout
from pipeline.errors import PuddleError
from pipeline.stages import environments
from pipeline.store import disk
from pipeline.store.design_file import columns_of_designs, open_designs
from pipeline.store.encoding import encode_table
from pipeline.store.tables import Columns, csv_of
from pipeline.workflow.stage import Execution
from tasks.evolution import OBJECTIVES
from tasks.residual import arm_kind
from tasks.simulation.fluids import is_compiled

_AT_ONCE, _WITH_TRACE = 4096, 64  # designs simulated in one call, to bound the memory
_SLOWLY = 4  # the same in other engines than the batch one, and in media that it does not compile
_UNITS = {
    "design": "row of the table, from 0",
    "diverged": "",
    "displacement": "m, of the root; of each member",
    "com_displacement": "m, of the centre of mass; of each member",
}


@with_options
def score(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="DESIGNS", help="A table of designs (.parquet, as `puddle export` writes), or a design file."
        ),
    ],
    depth: DepthOption,
    options: SettingsOptions,
    environment: EnvironmentOption = None,
    engine: EngineOption = None,
    out: Annotated[Path | None, typer.Option("--out", help="Write the scores (.parquet or .csv).")] = None,
) -> None:
    """Score a table of designs in one environment.

    The settings choose the length of the rollout. residual_slush uses the networks that the store holds for these
    settings, and its table has a column for each member.
    """
    settings = options.settings(to_compute=False)
    name, objective = checked_environment(settings, environment, depth), settings.evolution.maximised
    if objective.name not in OBJECTIVES:
        raise PuddleError(f"study {settings.name}: expected the code of its objective {objective.name}, found none")
    suffix = "" if out is None else output_suffix(out, (".parquet", ".csv"))
    if out is not None and out.resolve() == path.resolve():
        raise PuddleError(f"--out: expected another file than the designs', got {out}")
    designs = open_designs(path)
    networks = required_networks(options, settings, name) if name in settings.learners else {}
    simulation = environments.simulation_spec(settings, name)
    at = environments.build_environment(simulation.media, name, depth, networks)
    execution, fitness = Execution(engine or settings.work.engine), environments.fitness_spec(settings, name)
    parts: list[Columns] = []
    is_fast = execution.engine == "batch" and (at.medium is None or is_compiled(at.medium) or at.is_ensemble)
    at_once = (_WITH_TRACE if objective.trace else _AT_ONCE) if is_fast else _SLOWLY
    firsts = range(0, len(designs), at_once)
    with typer.progressbar(firsts, hidden=not sys.stderr.isatty(), file=sys.stderr) as shown:
        for first in shown:
            scores = environments.evaluate_designs(designs[first : first + at_once], simulation, execution, at, fitness)
            parts.append(
                {
                    "diverged": np.isneginf(scores.fitness),
                    "fitness": scores.fitness,
                    "displacement": scores.displacement if at.is_ensemble else scores.displacement[:, 0],
                    "com_displacement": scores.com_displacement if at.is_ensemble else scores.com_displacement[:, 0],
                }
            )
    table = {column: np.concatenate([part[column] for part in parts]) for column in parts[0]}
    table = {"design": np.arange(len(designs)), **table}
    where, n_diverged = f"{arm_kind(name, settings.arm_learners).label}, {depth:g} m deep", int(table["diverged"].sum())
    where += f", in {execution.engine}" * (execution.engine != "batch")
    to_stdout(f"{where}: {len(designs)} design{'s' * (len(designs) != 1)}, {n_diverged} diverged")
    finite = table["fitness"][~table["diverged"]]
    if len(finite):
        mean, median, best = (
            f"{value:z.2f} {objective.unit}".strip() for value in (finite.mean(), np.median(finite), finite.max())
        )
        to_stdout(f"  fitness ({objective.label.lower()}): mean {mean}, median {median}")
        to_stdout(f"  best: design {int(np.argmax(table['fitness']))}, {best}")
    if out is not None:
        units = {**_UNITS, "fitness": objective.unit}
        table = {**columns_of_designs(path), **table}
        content = encode_table(table, schema="scores", version=1, units=units)
        disk.write(out, content if suffix == ".parquet" else csv_of(table))
        to_stdout(f"  scores in {out}")
