"""puddle track: tagged bars in videos of a tank."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.bench.vision.markers_file import Markers
from pipeline.bench.vision.track_files import track_videos
from pipeline.bench.vision.track_video import TrackOptions
from pipeline.commands.options import MARKERS_OPTION, LensVideo, Slowdown, with_options
from pipeline.commands.terminal import to_stdout
from pipeline.config.loading import load


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
    tags = load(Markers, markers, overrides or ())
    to_stdout(*track_videos(videos, tags, out, TrackOptions(lens, slowdown, robot)))
