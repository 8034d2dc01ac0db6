"""puddle fabricate: the kit of a robot, or of bars to throw."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.bench.fabrication.make_kit import fabricate as make
from pipeline.bench.fabrication.source import from_file
from pipeline.bench.fabrication.throwing_kit import make_throwing_kit
from pipeline.commands.options import DEFAULT_STORE, Extensions, SettingsOptions, StorePath, StudyName, with_options
from pipeline.commands.proposal import check_errors, proposed
from pipeline.commands.terminal import INCOMPLETE, to_stderr, to_stdout
from pipeline.config.loading import load, parse
from pipeline.errors import PuddleError
from pipeline.results.recorded_study import open_study
from tasks.bench.fabrication.kit_settings import FabricationSettings


@with_options
def fabricate(
    design: Annotated[Path | None, typer.Argument(help="A design file (design.json).")] = None,
    study: StudyName = None,
    out: Annotated[Path, typer.Option("--out", help="The kit's folder: a new one, or a kit to replace.")] = Path("kit"),
    settings: Annotated[Path | None, typer.Option("--settings", help="A file with the kit's settings.")] = None,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", help="Change one: kit.servo=mg90s, kit.bed_mm=[180,180,180].")
    ] = None,
    preset: Annotated[
        str | None, typer.Option("--preset", help="Settings that simulate a design file; default pontoon.")
    ] = None,
    throwing_kit: Annotated[
        bool, typer.Option("--throwing-kit", help="Make bars to throw, their tags and a protocol instead of a robot.")
    ] = False,
    despite_errors: Annotated[
        bool, typer.Option("--despite-errors", help="Build also where networks predict tracked throws badly.")
    ] = False,
    extensions: Extensions = None,  # noqa: ARG001 (main has imported them)
    store: StorePath = DEFAULT_STORE,
) -> None:
    """Make the kit of a robot: parts, drawings, servo timeline.

    The robot is that of a design file, or the champion that a study proposes (--study). Exits with 1 where the kit
    names a reason not to build it.

    With --throwing-kit it makes bars to throw into a tank, their tags, a calibration board and a page that says how to
    film them. Their lengths and the tank are settings: --set throwing.lengths=[1,2,3].
    """
    if throwing_kit and (design is not None or study is not None or preset is not None):
        raise PuddleError("--throwing-kit: expected no design, --study or --preset: bars are not of a robot")
    if not throwing_kit and (design is None) == (study is None):
        raise PuddleError("expected either a design file or --study NAME: `puddle fabricate design.json`")
    if study is not None and preset is not None:
        why = "whose champion is simulated with the study's own settings"
        raise PuddleError(f"--preset: expected with a design file, got with --study {study}, {why}")
    if settings is not None:
        of_kit = load(FabricationSettings, settings, overrides or ())
    else:
        of_kit = parse(FabricationSettings, "", name="the kit's settings", overrides=overrides or ())
    if throwing_kit:
        to_stdout(*make_throwing_kit(of_kit, out))
        return
    if design is not None:
        source = from_file(design, SettingsOptions(preset=preset or "pontoon", store=store).settings())
    else:
        opened = open_study(str(study), store, say=to_stderr)
        if not despite_errors:
            check_errors(opened)
        source = proposed(opened)
    lines, n_faults = make(source, of_kit, out)
    to_stdout(*lines)
    if n_faults:
        raise typer.Exit(INCOMPLETE)
