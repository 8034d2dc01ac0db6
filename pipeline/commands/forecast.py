"""puddle forecast: hours and bytes per stage."""

from typing import Annotated

import typer

from pipeline.commands.exit_codes import interruptible, to_stderr
from pipeline.commands.options import StudyOptions, with_options


@with_options
def forecast(
    options: StudyOptions,
    cores: Annotated[
        list[int] | None, typer.Option("--cores", min=1, help="Also forecast for this many cores like this machine's.")
    ] = None,
) -> None:
    """Estimate how long the rest of a study will take, and how much disk it will use."""
    from pipeline.commands.cost_model import forecast_lines

    with interruptible():
        for line in forecast_lines(options.settings(), options.store, tuple(cores or ()), say=to_stderr):
            typer.echo(line)
