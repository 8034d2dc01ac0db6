"""puddle score: how far many designs get."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import GroundDepth, SimulatedIn, StudyOptions, with_options
from pipeline.commands.output import to_stdout


@with_options
def score(
    designs: Annotated[
        Path,
        typer.Argument(help="A table of designs: Parquet (as `puddle export` writes), or design files line by line."),
    ],
    environment: SimulatedIn,
    depth: GroundDepth,
    options: StudyOptions,
    out: Annotated[Path | None, typer.Option("--out", help="Write the scores (.parquet or .csv).")] = None,
) -> None:
    """Score a table of designs in one environment.

    The settings choose the length of the rollout. residual_slush uses the networks that the store holds for these
    settings, and its table has a column for each member.
    """
    from pipeline.commands.scored_designs import score_designs

    open_store = partial(options.open_store, create=False)
    for line in score_designs(designs, environment, depth, out, settings=options.settings(), open_store=open_store):
        to_stdout(line)
