"""puddle forecast: time and bytes per stage."""

from dataclasses import asdict
from typing import Annotated

import typer

from pipeline.commands.exit_codes import interruptible
from pipeline.commands.options import AsJson, StudyOptions, print_json, with_options
from pipeline.commands.output import to_stderr, to_stdout


@with_options
def forecast(
    options: StudyOptions,
    cores: Annotated[
        list[int] | None, typer.Option("--cores", min=1, help="Also forecast for this many cores like this machine's.")
    ] = None,
    gpu_tflops: Annotated[
        float | None,
        typer.Option("--gpu-tflops", help="Rate at which a GPU trains, where this machine has none [TFLOP/s]."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Estimate how long the rest of a study will take, and how much disk it will use.

    With training.device=cuda, training is timed on a GPU of this machine, or priced at --gpu-tflops: the rate that a
    GPU reaches, which is well below the peak that its maker states.
    """
    from pipeline.commands.cost_model import forecast_lines, forecast_study

    with interruptible():
        found = forecast_study(
            options.settings(), options.find_store(), tuple(cores or ()), gpu_tflops=gpu_tflops, say=to_stderr
        )
    if as_json:
        stages = [{**asdict(one), "seconds": {str(n): one.seconds(n) for n in found.n_cores}} for one in found.stages]
        print_json({**asdict(found), "stages": stages, "seconds": {str(n): found.seconds(n) for n in found.n_cores}})
        return
    for line in forecast_lines(found):
        to_stdout(line)
