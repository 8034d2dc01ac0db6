"""Commands for robots that are built: puddle fabricate, track and compare-run."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import (
    DEFAULT_STORE,
    MARKERS_OPTION,
    LensVideo,
    SettingsOptions,
    Slowdown,
    StorePath,
    StudyName,
    with_options,
)
from pipeline.commands.terminal import INCOMPLETE, to_stderr, to_stdout
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
    """Make the kit of a robot: parts, drawings, servo timeline.

    The robot is that of a design file, or the champion that a study proposes (--study). Exits with 1 where the kit
    names a reason not to build it.

    With --throwing-kit it makes bars to throw into a tank, their tags, a calibration board and a page that says how to
    film them. Their lengths and the tank are settings: --set throwing.lengths=[1,2,3].
    """
    from pipeline.bench.fabrication.make_kit import fabricate as make
    from pipeline.bench.fabrication.source import from_file
    from pipeline.bench.fabrication.throwing_kit import make_throwing_kit
    from pipeline.commands.proposal import proposed
    from pipeline.config.loading import load, parse
    from pipeline.results.recorded_study import open_study
    from tasks.bench.fabrication.kit_settings import FabricationSettings

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
        source = proposed(open_study(str(study), store, say=to_stderr))
    lines, n_faults = make(source, of_kit, out)
    to_stdout(*lines)
    if n_faults:
        raise typer.Exit(INCOMPLETE)


@with_options
def track(
    videos: Annotated[list[Path], typer.Argument(metavar="VIDEO...", help="Videos of the tank.")],
    markers: Annotated[Path, MARKERS_OPTION],
    out: Annotated[Path, typer.Option("--out", help="The tracks file (.csv).")] = Path("tracks.csv"),
    lens: LensVideo = None,
    slowdown: Slowdown = 1.0,
    robot: Annotated[
        bool, typer.Option("--robot", help="Track the links of a built robot, through the whole video.")
    ] = False,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", help="Change one value of the markers file: dictionary=apriltag_36h11.")
    ] = None,
) -> None:
    """Track tagged bars in videos: positions, angles, uncertainty.

    The tracks file is what `puddle collect --tracks` reads. Beside it come the bars' sizes and a film of each video
    with what was found. A throw begins where all tags of a bar are seen inside the rectangle of the tank's corner tags.
    It ends when the bar leaves the rectangle, is not seen for 0.1 s, or rests.
    """
    from pipeline.bench.vision import require_vision
    from pipeline.bench.vision.markers_file import Markers
    from pipeline.bench.vision.track_files import track_videos
    from pipeline.bench.vision.track_video import TrackOptions
    from pipeline.config.loading import load

    require_vision()
    found = load(Markers, markers, overrides or ())
    to_stdout(*track_videos(videos, found, out, TrackOptions(lens, slowdown, robot)))


@with_options
def compare_run(
    run: Annotated[Path, typer.Argument(metavar="VIDEO-or-TRACKS", help="A video of the run, or its tracks (.csv).")],
    kit: Annotated[Path, typer.Option("--kit", help="The robot's kit, a folder of `puddle fabricate`.")],
    study: StudyName = None,
    markers: Annotated[Path | None, MARKERS_OPTION] = None,
    lens: LensVideo = None,
    slowdown: Slowdown = 1.0,
    out: Annotated[Path, typer.Option("--out", help="The page (.html).")] = Path("run.html"),
    store: StorePath = DEFAULT_STORE,
) -> None:
    """Compare a built robot's run with what was predicted.

    How far and how fast it went, and its gait, stand on the terminal and on a page. The prediction is that of a study's
    ensemble (--study), or what the kit records; its interval is two standard deviations of the members to either side.
    """
    from pipeline.commands.run_comparison import RunSource, compare_built_run

    source = RunSource(run, markers, lens, slowdown)
    to_stdout(*compare_built_run(source, kit, study, store, out))
