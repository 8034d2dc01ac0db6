"""puddle suggest-throws: which throws to make next."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import DEFAULT_STORE, MARKERS_OPTION, StorePath, names_of_studies, with_options
from pipeline.commands.output import to_stdout
from pipeline.errors import PuddleError


@with_options
def suggest_throws(
    study: Annotated[
        str, typer.Option("--study", metavar="NAME", autocompletion=names_of_studies, help="A study of the store.")
    ],
    n: Annotated[int, typer.Option("--n", help="Number of throws.")] = 20,
    throws: Annotated[
        str | None,
        typer.Option("--throws", help="Settings group of the throws made so far: throws or designed_throws."),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Write the starts (.csv).")] = None,
    scale: Annotated[
        float | None,
        typer.Option(
            "--scale", min=1.0, max=1000.0, help="Bench mm per metre of simulation, such as 70: starts in bench units."
        ),
    ] = None,
    max_speed: Annotated[
        float | None, typer.Option("--max-speed", min=0.0, help="Fastest throw that you can make [m/s].")
    ] = None,
    max_spin: Annotated[
        float | None, typer.Option("--max-spin", min=0.0, help="Fastest spin that you can give [turns/s].")
    ] = None,
    heights: Annotated[
        tuple[float, float] | None, typer.Option("--heights", help="Lowest and highest start over the water [m].")
    ] = None,
    markers: Annotated[Path | None, MARKERS_OPTION] = None,
    sheet: Annotated[Path | None, typer.Option("--sheet", help="Write a page to print (.html).")] = None,
    store: StorePath = DEFAULT_STORE,
) -> None:
    """List the starts of throws that fill the holes in what a study's networks learned from.

    The first half covers the range of robots' states evenly. The other half are states that robots pass through, where
    the members disagree far from every throw. Limits and results are in the simulation's units, or with --scale in
    those of a bench, by Froude's law.
    """
    import math
    import shlex

    from pipeline.config.loading import load
    from pipeline.results.recorded_study import open_study
    from pipeline.results.suggested_throws import TankScale, as_csv, as_lines, as_sheet, suggested_throws
    from pipeline.store import disk
    from pipeline.vision.markers_file import Markers
    from pipeline.workflow.stage import MissingInputs
    from tasks.residual.suggestion import ThrowLimits

    if scale is None and (sheet or markers):
        raise PuddleError("--sheet and --markers are for a tank: expected its scale in mm per metre, --scale 70")
    if heights is not None and not heights[0] < heights[1]:
        raise PuddleError(f"--heights: expected the lowest first, got {heights[0]:g} {heights[1]:g}")
    if out is not None and sheet is not None and out.resolve() == sheet.resolve():
        raise PuddleError(f"--sheet: expected another file than that of --out, got {sheet}")
    bench = TankScale(1.0 if scale is None else scale / 1000)
    bars = () if markers is None else load(Markers, markers).bars
    if markers is not None and not bars:
        raise PuddleError(f"--markers: expected bars to throw, found none in {markers}")
    limits = ThrowLimits(
        max_velocity=math.inf if max_speed is None else max_speed / bench.speed,
        max_omega=math.inf if max_spin is None else 2 * math.pi * max_spin * bench.time,
        heights=(-math.inf, math.inf) if heights is None else (heights[0] / bench.scale, heights[1] / bench.scale),
        lengths=tuple(bar.length / bench.scale for bar in bars),
    )
    of_study = open_study(study, store)
    try:
        starts = suggested_throws(of_study, n, throws, limits)
    except MissingInputs as missing:
        again = shlex.join(["puddle", "pilot", "--study", study, "--store", str(store)])
        raise PuddleError(
            f"study {study}: {missing}. Run the stages up to pilot first, the last by `{again}`."
        ) from None
    for line in as_lines(starts, bench):
        to_stdout(line)
    made = of_study.settings.throws_of(throws or of_study.settings.throw_groups[0])
    if made.source == "simulation":
        n_steps = made.n_steps_of(of_study.settings.physics)
        to_stdout(f"{n:,} throws are {n * n_steps:,} transitions, if followed for {n_steps} steps as the study's are")
    for path, content in (
        (out, as_csv(starts, bench)),
        (sheet, "" if sheet is None else as_sheet(starts, bench, study)),
    ):
        if path is not None:
            with disk.explained("writing throws", path, advice="choose another file"):
                path.write_text(content, encoding="utf-8")
            to_stdout(f"{'starts' if path == out else 'sheet'} in {path}")
