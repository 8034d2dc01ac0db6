"""puddle fabricate: the kit of a robot."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.exit_codes import INCOMPLETE, interruptible
from pipeline.commands.options import DEFAULT_STORE, StorePath, StudyName, StudyOptions, with_options
from pipeline.commands.output import to_stdout
from pipeline.errors import PuddleError


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
    store: StorePath = DEFAULT_STORE,
) -> None:
    """Make the kit of a robot: printable parts, bill of materials, drawings, scaling, and the servos' timeline.

    The robot is that of a design file, or the champion that a study proposes (--study). Exits with 1 where the kit
    names a reason not to build it.

    With --throwing-kit it makes bars to throw into a tank, their tags, a calibration board and a page that says how to
    film them. Their lengths and the tank are settings: --set throwing.lengths=[1,2,3].
    """
    from pipeline.config.loading import load, parse
    from pipeline.fabrication.make_kit import fabricate as make
    from pipeline.fabrication.source import from_file, proposed
    from pipeline.results.recorded_study import open_study
    from tasks.fabrication.kit_settings import FabricationSettings

    def of_the_kit() -> FabricationSettings:
        if settings is not None:
            return load(FabricationSettings, settings, overrides or ())
        return parse(FabricationSettings, "", name="the kit's settings", overrides=overrides or ())

    if throwing_kit:
        from pipeline.fabrication.throwing_kit import make_throwing_kit

        if design is not None or study is not None or preset is not None:
            raise PuddleError("--throwing-kit: expected no design, --study or --preset: bars are not of a robot")
        for line in make_throwing_kit(of_the_kit(), out):
            to_stdout(line)
        return
    if (design is None) == (study is None):
        raise PuddleError("expected either a design file or --study NAME: `puddle fabricate design.json`")
    if study is not None and preset is not None:
        why = "whose champion is simulated with the study's own settings"
        raise PuddleError(f"--preset: expected with a design file, got with --study {study}, {why}")
    of_kit = of_the_kit()
    with interruptible():
        if design is not None:
            source = from_file(design, StudyOptions(preset=preset or "pontoon", store=store).settings())
        else:
            source = proposed(open_study(str(study), store))
        made = make(source, of_kit, out)
    for line in made.lines:
        to_stdout(line)
    if made.n_faults:
        raise typer.Exit(INCOMPLETE)
