"""Videos of a tank: bars, or the links of a robot, are found in every frame and followed through it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pipeline.bench.vision import require_vision
from pipeline.bench.vision.markers_file import Markers, TaggedBar
from pipeline.bench.vision.tags import find_tags, lens_of_board
from pipeline.bench.vision.video import frames
from pipeline.errors import PuddleError
from tasks.arrays import Float64, Ints
from tasks.bench.tracks.repeats import repeated
from tasks.bench.vision.bar_pose import BarPose, fit_bar, tag_corners, typical_noise
from tasks.bench.vision.plane import CalibrationError, Lens, SeenPlane, assumed_lens, fit_plane
from tasks.bench.vision.throw_spans import MIN_FRAMES, throw_spans

_MOST_MISFIT_PX = 2.0  # of the tank's corners; paper bends, but not by more
_MOST_BAR_MISFIT_PX = 1.0  # of a bar's corners in its median frame; sharp ones are seen to a tenth of that
_MOVES = 6.0  # deviations by which a bar that moves is farther on in the next picture
_MOST_SHIFT_PX = 1.5  # of a tank tag between the halves of a video


@dataclass(frozen=True)
class TrackOptions:
    """What a user may choose of the tracking."""

    lens_video: Path | None = None
    """Video of the printed board; None assumes a lens and fits its k1 to the tank's tags."""
    slowdown: float = 1.0
    """How many times slower than life the videos play: 8 for 240 frames per second stored at 30."""
    robot: bool = False
    """Whether the tags of a robot's links are tracked, through the whole video, instead of thrown bars."""


@dataclass(frozen=True, eq=False)
class Track:
    """One throw of one bar, or one link of a robot, in one video."""

    throw: int  # number of the throw, or of the link
    bar: TaggedBar
    frame: Ints  # (n,) indices of the frames in which it is seen
    time: Float64  # (n,) [s]
    pose: Float64  # (n, 3) x, y over the waterline [m] and angle [rad], unwrapped
    deviation: Float64  # (n, 3) standard deviations of the pose
    n_lost: int  # frames between its first and its last in which it is not seen
    n_repeated: int  # frames that repeat the picture before, and are left out
    lost_from_sight: bool  # whether it ends because the bar is not seen, rather than outside the zone or at rest


@dataclass(frozen=True, eq=False)
class VideoTracks:
    """What one video holds."""

    path: Path
    size: tuple[int, int]  # width and height of its pictures [px]
    plane: SeenPlane  # in metres from the waterline
    tracks: tuple[Track, ...]
    rate: float  # frames per second
    lines: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Sightings:
    """The tags in every frame of a video."""

    path: Path
    size: tuple[int, int]  # width and height of the pictures [px]
    time: Float64  # (n_frames,) [s]
    tags: list[dict[int, Float64]]


def follow(videos: Sequence[Path], markers: Markers, options: TrackOptions) -> tuple[list[VideoTracks], list[str]]:
    """Track the bars in videos, or a robot in one. Returns what each video holds, and lines for the terminal.

    Raises PuddleError if a video can't be read or calibrated, or holds nothing to track.
    """
    require_vision()
    if options.robot and len(videos) > 1:
        raise PuddleError(f"--robot: expected one video of one run, got {len(videos)}")
    lines: list[str] = []
    lens, lens_size = None, None
    if options.lens_video is not None:
        lens, lens_size, line = lens_of_board(options.lens_video, markers)
        lines.append(line)
    tracked: list[VideoTracks] = []
    for path in videos:
        sightings = _sightings(path, markers, options.slowdown)
        if lens_size is not None and lens_size != sightings.size:
            film, board = ("{} × {}".format(*size) for size in (sightings.size, lens_size))
            raise PuddleError(
                f"{path}: its pictures have {film} px, those of {options.lens_video} {board}: film the board with the "
                f"same camera, zoom and size as the throws"
            )
        n_before = sum(len(video.tracks) for video in tracked)
        tracked.append(_tracked(sightings, markers, lens, options, n_before))
        lines += tracked[-1].lines
    if not any(video.tracks for video in tracked):
        what = "link of a robot" if options.robot else "throw"
        advice = (
            f"Its tags have the numbers from {markers.robot.first} on, see `robot` in the markers file."
            if options.robot
            else "A throw begins where all tags of a bar are seen inside the rectangle of the tank's corner tags, and "
            f"lasts at least {MIN_FRAMES} frames."
        )
        names = ", ".join(map(str, videos))
        raise PuddleError(f"{names}: expected at least one {what}, found none. {advice}")
    return tracked, lines


def _sightings(path: Path, markers: Markers, slowdown: float) -> _Sightings:
    """Find the tags of a video."""
    time, tags, size = [], [], (0, 0)
    for frame in frames(path):
        tags.append(find_tags(markers, frame.picture, f"{path}: frame {frame.index}"))
        time.append(frame.time / slowdown)
        size = (frame.picture.shape[1], frame.picture.shape[0])
    if not any(tags):
        raise PuddleError(
            f"{path}: expected tags of the markers file, found none in {len(tags)} frames. Check `dictionary` "
            f"({markers.dictionary}); tags need white paper around them, light, and 4 px for each of their squares. A "
            f"mirrored video shows none."
        )
    return _Sightings(path, size, np.array(time), tags)


def _tracked(
    sightings: _Sightings, markers: Markers, lens: Lens | None, options: TrackOptions, n_before: int
) -> VideoTracks:
    """Calibrate a video and fit the poses of its bars; throws are numbered on from ``n_before``."""
    plane, misfit = _plane(sightings, markers, lens)
    bars = markers.robot.bars() if options.robot else markers.bars
    fits = [_fits(sightings, plane, bar) for bar in bars]
    noise = typical_noise([fit for fits_of_bar in fits for fit in fits_of_bar.values()])
    tracks: list[Track] = []
    for number, (bar, fits_of_bar) in enumerate(zip(bars, fits, strict=True)):
        path = _path_of(sightings, bar, fits_of_bar, noise)
        if options.robot:
            spans: list[Ints] = [np.flatnonzero(path.n_seen)] if path.n_seen.any() else []
        else:
            in_zone = markers.tank.zone_holds(path.pose[:, :2])
            spans = throw_spans(sightings.time, path.n_seen, path.pose, in_zone, n_tags=len(bar.tags))
        of_spans = (_track_of(span, sightings.time, path, bar, number) for span in spans)
        tracks += [track for track in of_spans if len(track.time) >= MIN_FRAMES or options.robot]
    if not options.robot:
        tracks.sort(key=lambda track: track.time[0])
        tracks = [replace(track, throw=n_before + i) for i, track in enumerate(tracks)]
    interval = float(np.median(np.diff(sightings.time))) if len(sightings.time) > 1 else 1.0
    lines = _lines(sightings, tracks, misfit, noise, interval, options.robot)
    return VideoTracks(sightings.path, sightings.size, plane, tuple(tracks), 1 / interval, tuple(lines))


@dataclass(frozen=True, eq=False)
class _Path:
    """A bar in every frame of a video."""

    pose: Float64  # (n_frames, 3); 0 where no tag is seen
    deviation: Float64  # (n_frames, 3)
    n_seen: Ints  # (n_frames,) number of its tags that are seen


def _path_of(sightings: _Sightings, bar: TaggedBar, fits: Mapping[int, BarPose], noise: float) -> _Path:
    n_frames = len(sightings.time)
    path = _Path(np.zeros((n_frames, 3)), np.zeros((n_frames, 3)), np.zeros(n_frames, int))
    for frame, fit in fits.items():
        path.pose[frame], path.deviation[frame] = fit.pose, fit.deviation(noise)
        path.n_seen[frame] = sum(tag.number in sightings.tags[frame] for tag in bar.tags)
    return path


def _track_of(span: Ints, time: Float64, path: _Path, bar: TaggedBar, number: int) -> Track:
    """Return the track of a bar in some frames, without those that repeat the picture before."""
    pose = np.column_stack((path.pose[span, :2], np.unwrap(path.pose[span, 2])))
    usual = np.median(path.deviation[span], axis=0)
    again = repeated(pose, usual, _MOVES * usual)
    new = span[~again]
    return Track(
        throw=number,
        bar=bar,
        frame=new,
        time=time[new],
        pose=pose[~again],
        deviation=path.deviation[new],
        n_lost=int(span[-1] - span[0] + 1 - len(span)),
        n_repeated=int(again.sum()),
        lost_from_sight=bool((path.n_seen[span[-1] + 1 : span[-1] + 2] == 0).any()),
    )


def _lines(
    sightings: _Sightings, tracks: Sequence[Track], misfit: float, noise: float, interval: float, robot: bool
) -> Iterator[str]:
    """Say what a video holds."""
    name = sightings.path.name
    n_dropped = int(np.maximum(np.round(np.diff(sightings.time) / interval) - 1, 0).sum())
    yield (
        f"{name}: {len(sightings.time)} frames, {1 / interval:.1f} per second, {n_dropped} dropped by the camera; the "
        f"tank's tags fit to {misfit:.2f} px"
    )
    if tracks:
        seen, lost = sum(len(track.time) for track in tracks), sum(track.n_lost for track in tracks)
        x, _, angle = np.median(np.concatenate([track.deviation for track in tracks]), axis=0)
        yield (
            f"{name}: {len(tracks)} {'links' if robot else 'throws'}, lost in {lost} of {seen + lost} frames "
            f"({lost / (seen + lost):.1%}); corners to {noise:.2f} px, which is {1000 * x:.2f} mm and "
            f"{np.degrees(angle):.2f}°"
        )
    if n_repeated := sum(track.n_repeated for track in tracks):
        rate = 1 / np.median(np.concatenate([np.diff(track.time) for track in tracks]))
        yield f"{name}: {n_repeated} frames repeat the one before, and are left out: {rate:.1f} a second are new"
    if (n_cut := sum(track.lost_from_sight for track in tracks)) and not robot:
        yield f"{name}: in {n_cut} throws the bar is lost from sight inside the tank; see the check film"


def _fits(sightings: _Sightings, plane: SeenPlane, bar: TaggedBar) -> dict[int, BarPose]:
    """Fit a bar in every frame that shows one of its tags.

    A bar whose corners do not fit the markers file is refused: the fits would take what is wrong there for noise.
    """
    on_bar = {tag.number: tag_corners(tag.size, tag.across, tag.along) for tag in bar.tags}
    fits: dict[int, BarPose] = {}
    for frame, tags in enumerate(sightings.tags):
        if shown := [number for number in on_bar if number in tags]:
            pixels = np.concatenate([tags[number] for number in shown])
            corners = np.concatenate([on_bar[number] for number in shown])
            fit = fit_bar(corners, plane.metres(pixels), plane.jacobian(pixels))
            if np.isfinite([*fit.pose, fit.chi2]).all():
                fits[frame] = fit
    squares = [fit.chi2 / fit.freedom for fit in fits.values()]
    if squares and (misfit := float(np.sqrt(np.median(squares)))) > _MOST_BAR_MISFIT_PX:
        numbers = " and ".join(map(str, on_bar))
        raise PuddleError(
            f"{sightings.path}: the bar with tag{'s' * (len(bar.tags) > 1)} {numbers}: its corners fit to {misfit:.1f} "
            f"px, expected at most {_MOST_BAR_MISFIT_PX:g}: measure its tags (size, along, across) and the tank's (x, "
            f"y, tag_size) again, and see that no two tags were exchanged or turned"
        )
    return fits


def _plane(sightings: _Sightings, markers: Markers, lens: Lens | None) -> tuple[SeenPlane, float]:
    """Fit the plane of the tank's tags in metres from the waterline; returns the distances left, too [px]."""
    path, tank = sightings.path, markers.tank
    seen = [_still(sightings, tag.number) for tag in tank.corners]
    metres = np.concatenate([tag_corners(tank.tag_size, tag.x, tag.y - tank.waterline) for tag in tank.corners])
    try:
        chosen = assumed_lens(*sightings.size) if lens is None else lens
        plane, misfit = fit_plane(metres, np.concatenate(seen), chosen, radial=lens is None)
    except (CalibrationError, np.linalg.LinAlgError) as error:
        raise PuddleError(f"{path}: the tank's tags: {error}. Check `tank` in the markers file.") from None
    if not misfit <= _MOST_MISFIT_PX:
        off = np.linalg.norm(plane.pixels(metres) - np.concatenate(seen), axis=1).reshape(-1, 4).max(axis=1)
        worst = tank.corners[int(off.argmax())].number
        raise PuddleError(
            f"{path}: frames 0 to {len(sightings.time) - 1}: the tank's tags do not lie where the markers file says: "
            f"{misfit:.1f} px are left, expected at most {_MOST_MISFIT_PX:g}; tag {worst} is {off.max():.1f} px away. "
            f"Measure the centres of the tags and tag_size again, and lay the tags flat and upright."
        )
    return plane, misfit


def _still(sightings: _Sightings, number: int) -> Float64:
    """Return the (4, 2) median corners of a tag that does not move [px]."""
    path = sightings.path
    where = [i for i, tags in enumerate(sightings.tags) if number in tags]
    if not where:
        others = ", ".join(map(str, sorted({other for tags in sightings.tags for other in tags})))
        raise PuddleError(
            f"{path}: tag {number} of the tank is seen in no frame of 0 to {len(sightings.tags) - 1}; seen are "
            f"{others}. All corner tags must be in the picture, upright, flat and lit."
        )
    corners = np.array([sightings.tags[i][number] for i in where])
    halves = np.array_split(corners, 2) if len(where) > 1 else [corners, corners]
    shift = np.linalg.norm(np.median(halves[1], axis=0) - np.median(halves[0], axis=0), axis=1).max()
    if shift > _MOST_SHIFT_PX:
        raise PuddleError(
            f"{path}: tag {number} of the tank moved by {shift:.1f} px between frames {where[0]} and {where[-1]}: "
            f"expected at most {_MOST_SHIFT_PX:g}. Fix camera and tank, switch off the stabiliser, or cut the video in "
            f"two where it was knocked."
        )
    return np.asarray(np.median(corners, axis=0))
