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
    gpus: Annotated[
        int, typer.Option("--gpus", min=1, help="GPUs that train networks with training.device=cuda, one each.")
    ] = 1,
    driver_ms: Annotated[
        float | None,
        typer.Option(
            "--driver-ms", help="The driver's time for a small work item, if not as docs/cluster.md says [ms]."
        ),
    ] = None,
    network_gbit: Annotated[
        float | None, typer.Option("--network-gbit", help="Rate of the driver's network, if not 1 Gbit/s [Gbit/s].")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Estimate how long the rest of a study will take, and how much disk it will use.

    With training.device=cuda, training is timed on a GPU of this machine, or priced at --gpu-tflops: the rate that a
    GPU reaches, which is well below the peak that its maker states.
    """
    from pipeline.commands.cost_model import DriverLimits, forecast_study
    from pipeline.commands.forecast_table import forecast_lines

    with interruptible():
        found = forecast_study(
            options.settings(),
            options.find_store(),
            tuple(cores or ()),
            gpu_tflops=gpu_tflops,
            n_gpus=gpus,
            driver=DriverLimits.stated(driver_ms, network_gbit),
            say=to_stderr,
        )
    if as_json:
        stages = [
            {
                **asdict(one),
                "seconds": {str(n): found.stage_seconds(one, n) for n in found.n_cores},
                "limit": {str(n): found.limit(one, n) for n in found.n_cores},
            }
            for one in found.stages
        ]
        print_json({**asdict(found), "stages": stages, "seconds": {str(n): found.seconds(n) for n in found.n_cores}})
        return
    for line in forecast_lines(found):
        to_stdout(line)
