"""puddle compare-run: whether a built robot moves as predicted."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import (
    DEFAULT_STORE,
    MARKERS_OPTION,
    LensVideo,
    Slowdown,
    StorePath,
    StudyName,
    with_options,
)
from pipeline.commands.output import to_stdout


@with_options
def compare_run(
    run: Annotated[Path, typer.Argument(metavar="VIDEO-or-TRACKS", help="A video of the run, or its tracks (.csv).")],
    kit: Annotated[Path, typer.Option("--kit", help="The robot's kit, a folder of `puddle fabricate`.")],
    study: StudyName = None,
    markers: Annotated[Path | None, MARKERS_OPTION] = None,
    lens: LensVideo = None,
    slowdown: Slowdown = 1.0,
    start: Annotated[
        float | None,
        typer.Option(
            "--start", help="Time in the video at which the servos began [s]; found from the joints if not given."
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="The page (.html).")] = Path("run.html"),
    store: StorePath = DEFAULT_STORE,
) -> None:
    """Compare the run of a built robot with its simulation, and with what the ensemble predicted.

    Path, speed and the phase lag of each joint stand on the terminal and on a page. The prediction is that of a study's
    ensemble (--study), or what the kit records; its interval is two standard deviations of the members to either side.
    """
    from pipeline.commands.run_comparison import RunSource, compare_built_run

    source = RunSource(run, markers, lens, slowdown, start)
    for line in compare_built_run(source, kit, study, store, out):
        to_stdout(line)
