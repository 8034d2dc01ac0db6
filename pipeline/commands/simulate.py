"""puddle simulate: how far one design gets."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import GroundDepth, SimulatedIn, StudyOptions, with_options
from pipeline.commands.output import to_stdout


@with_options
def simulate(
    design: Annotated[Path, typer.Argument(help="A design file (design.json).")],
    environment: SimulatedIn,
    depth: GroundDepth,
    options: StudyOptions,
    out: Annotated[Path | None, typer.Option("--out", help="Write a film (.gif, .mp4) or a page (.html).")] = None,
) -> None:
    """Simulate one design, print its displacement, and show it.

    The settings choose the length of the rollout. residual_slush uses the networks that the store holds for these
    settings. A page uses them in any environment: its colours show where the networks disagree, and how far the robot
    strays from the throws.
    """
    from pipeline.commands.one_design import simulate_design

    settings, how_to_run = options.settings(), options.command
    open_store = partial(options.open_store, create=False)
    for line in simulate_design(
        design, environment, depth, out, settings=settings, open_store=open_store, how_to_run=how_to_run
    ):
        to_stdout(line)
