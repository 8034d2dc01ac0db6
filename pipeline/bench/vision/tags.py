"""Tags and boards of OpenCV: found in pictures, and drawn to be printed."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.bench.vision.markers_file import BoardOfMarkers, Dictionary, Markers
from pipeline.bench.vision.video import Picture, frames
from pipeline.errors import PuddleError
from tasks.arrays import Bools, Float64
from tasks.bench.vision.plane import Lens

_LEAST_CORNERS, _MOST_VIEWS = 8, 40  # of the board in a frame; of frames that calibrate the lens
_LEAST_VIEWS, _MOST_MISFIT_PX = 6, 1.5
_LEAST_SHIFT = 0.02  # of corners between two frames that count as different views, over the picture's width


@cache
def dictionary_of(name: Dictionary) -> Any:
    """Return a dictionary of OpenCV."""
    import cv2

    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}".upper()))


def modules(name: Dictionary, number: int) -> Bools:
    """Return the (n, n) modules of a tag, True where black, its border included."""
    dictionary = dictionary_of(name)
    n_tags, n = len(dictionary.bytesList), dictionary.markerSize + 2
    if number >= n_tags:
        raise PuddleError(f"tag {number}: expected a number below {n_tags}, as many as {name} has")
    return np.asarray(dictionary.generateImageMarker(number, n) == 0)


def find_tags(markers: Markers, picture: Picture, where: str) -> dict[int, Float64]:
    """Return (4, 2) corners [px] of the tags of a markers file in a picture, by their numbers.

    Raises PuddleError if a tag is seen twice; it names ``where``, the file and frame.
    """
    corners, numbers, _ = _detector_of(markers.dictionary).detectMarkers(picture)
    known, seen = set(markers.numbers()), dict[int, Float64]()
    for number, (four,) in zip([] if numbers is None else numbers.ravel().tolist(), corners, strict=True):
        if number in seen:
            at = " and ".join("({:.0f}, {:.0f})".format(*tag.mean(axis=0)) for tag in (seen[number], four))
            raise PuddleError(
                f"{where}: tag {number} is seen twice, at {at} px: expected every tag once. Remove the second one "
                f"from the picture, or give it another number in the markers file."
            )
        if number in known:
            seen[number] = four.astype(np.float64)
    return seen


def _shift(view: dict[int, Float64], other: dict[int, Float64]) -> float:
    """Return by how much the corners that two views share are apart [px]; infinity if they share none."""
    apart = [float(np.linalg.norm(view[number] - other[number])) for number in view.keys() & other.keys()]
    return float(np.median(apart)) if apart else float("inf")


@cache
def _detector_of(name: Dictionary) -> Any:
    import cv2

    options = cv2.aruco.DetectorParameters()
    options.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    # A corner is sought this far from where the outline was seen, in squares of its tag. OpenCV's 0.3 is one pixel for
    # tags of 20 px, which is too near and turns them by up to 1.5°; from 1 on, other squares come into view.
    options.relativeCornerRefinmentWinSize = 0.8
    options.minMarkerPerimeterRate = 0.01  # of the picture's longer side: tags of 5 px are found
    return cv2.aruco.ArucoDetector(dictionary_of(name), options)


def charuco_board(board: BoardOfMarkers, name: Dictionary) -> Any:
    """Return a board of OpenCV, in metres."""
    import cv2

    numbers = np.arange(board.first, board.first + board.n_tags)
    return cv2.aruco.CharucoBoard(
        (board.columns, board.rows), board.square, board.marker, dictionary_of(name), numbers.astype(np.int32)
    )


def lens_of_board(path: Path, markers: Markers) -> tuple[Lens, tuple[int, int], str]:
    """Calibrate a lens from a video of the printed board, filmed as the throws are.

    Returns the lens, the width and height of its pictures [px], and a line that says how well it fits. Raises
    PuddleError if the board is seen in too few frames, or no lens fits.
    """
    import cv2

    board = charuco_board(markers.board, markers.dictionary)
    detector = cv2.aruco.CharucoDetector(board)
    views: list[dict[int, Float64]] = []
    n_seen, size = 0, (0, 0)
    for frame in frames(path):
        size = (frame.picture.shape[1], frame.picture.shape[0])
        corners, numbers, _, _ = detector.detectBoard(frame.picture)
        if numbers is not None and len(numbers) >= _LEAST_CORNERS:
            n_seen += 1
            view = dict(zip(numbers.ravel().tolist(), corners.reshape(-1, 2).astype(np.float64), strict=True))
            if all(_shift(view, other) > _LEAST_SHIFT * size[0] for other in views):
                views.append(view)
    if len(views) < _LEAST_VIEWS:
        raise PuddleError(
            f"{path}: expected the board with at least {_LEAST_CORNERS} corners in at least {_LEAST_VIEWS} frames that "
            f"differ, got {len(views)} of {n_seen}. Film it slowly from several sides, all of it in the picture, sharp "
            f"and flat; check `board` and `dictionary` in the markers file."
        )
    chosen = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, _MOST_VIEWS).astype(int))]
    matched = [
        board.matchImagePoints(np.array([*view.values()], np.float32)[:, None], np.array([*view])[:, None])
        for view in chosen
    ]
    points, pixels = [view[0] for view in matched], [view[1] for view in matched]
    misfit, camera, distortion, _, _ = cv2.calibrateCamera(points, pixels, size, None, None)
    if not misfit <= _MOST_MISFIT_PX:
        raise PuddleError(
            f"{path}: no lens fits the board: {misfit:.1f} px are left, expected at most {_MOST_MISFIT_PX:g}. Lay the "
            f"board on glass or stiff card, switch off the camera's stabiliser and zoom, and film it again."
        )
    k1, k2, p1, p2, k3 = distortion.ravel()[:5].tolist()
    lens = Lens((camera[0, 0], camera[1, 1]), (camera[0, 2], camera[1, 2]), (k1, k2, p1, p2, k3))
    return lens, size, f"{path.name}: the lens fits {len(chosen)} of {len(views)} views of the board to {misfit:.2f} px"
