"""puddle simulate and puddle score: how far designs get, one or many."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import SettingsOptions, with_options
from pipeline.commands.terminal import to_stdout

_Environment = Annotated[
    str | None, typer.Option("--environment", help="The environment, by default the target; a wrong name lists all.")
]
_Depth = Annotated[float, typer.Option("--depth", help="Depth of the ground below the surface [m].")]


@with_options
def simulate(
    design: Annotated[Path, typer.Argument(help="A design file (design.json).")],
    depth: _Depth,
    options: SettingsOptions,
    environment: _Environment = None,
    out: Annotated[Path | None, typer.Option("--out", help="Write a film (.gif, .mp4) or a page (.html).")] = None,
) -> None:
    """Simulate one design, print its displacement, and show it.

    The settings choose the length of the rollout. residual_slush uses the networks that the store holds for these
    settings. Where there are networks, a page shows the design in the target and residual_slush side by side, and by
    colours where the networks disagree.
    """
    from pipeline.commands.simulations import simulate_design

    to_stdout(*simulate_design(design, environment, depth, out, options))


@with_options
def score(
    designs: Annotated[
        Path, typer.Argument(help="A table of designs (.parquet, as `puddle export` writes), or a design file.")
    ],
    depth: _Depth,
    options: SettingsOptions,
    environment: _Environment = None,
    out: Annotated[Path | None, typer.Option("--out", help="Write the scores (.parquet or .csv).")] = None,
) -> None:
    """Score a table of designs in one environment.

    The settings choose the length of the rollout. residual_slush uses the networks that the store holds for these
    settings, and its table has a column for each member.
    """
    from pipeline.commands.simulations import score_designs

    to_stdout(*score_designs(designs, environment, depth, out, options))
