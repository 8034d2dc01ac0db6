"""puddle track, on videos of a synthetic camera whose throws are known."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
import yaml
from command_line import call as called
from command_line import refused

from pipeline.bench.vision import track_video
from pipeline.bench.vision.tags import find_tags
from pipeline.bench.vision.video import film, frames
from tasks.bench.vision.bar_pose import fit_bar, tag_corners


def call(*words):
    return called(*map(str, words))


def table(path):
    return np.genfromtxt(path, delimiter=",", names=True)


def errors(tank, tracks):
    """Return the errors of x, y [m] and angle [rad] over all tracked frames."""
    row = np.abs(tracks["time"][:, None] - tank.truth[:, 1]).argmin(axis=1)
    assert np.abs(tracks["time"] - tank.truth[row, 1]).max() < 1e-3
    off = np.stack([tracks[name] for name in ("x", "y", "angle")], axis=1) - tank.truth[row, 2:5]
    off[:, 2] = (off[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return off


def track(tank, out, *options):
    return call("track", tank.folder / "throws.mp4", "--markers", tank.folder / "markers.yaml", "--out", out, *options)


@pytest.mark.parametrize("lens", [True, False])
def test_throws_are_where_they_were(tank, tmp_path, lens, capsys):
    """A pixel is 0.8 mm. The bars are 3 mm behind the tags at 700 mm, which shifts them by up to 0.4 % of 0.2 m."""
    out = tmp_path / "tracks.csv"
    assert track(tank, out, *(("--lens", tank.folder / "board.mp4") if lens else ())) == 0
    said = capsys.readouterr().out
    tracks = table(out)
    assert np.unique(tracks["throw"]).tolist() == [0, 1, 2] and len(tracks) >= 0.95 * len(tank.truth)
    bias = np.abs(errors(tank, tracks)).max(axis=0)
    assert bias[0] < 1.5e-3 and bias[1] < 1.5e-3
    assert np.sqrt(np.square(errors(tank, tracks)[:, 2]).mean()) < 0.01
    assert 0.1 < np.median(tracks["x_sd"]) * 1e4 < 5 and 5e-4 < np.median(tracks["angle_sd"]) < 0.02
    bars = table(tmp_path / "tracks-bars.csv")
    assert bars["throw"].tolist() == [0, 1, 2] and bars["length"].tolist() == pytest.approx([0.07, 0.105, 0.07])
    assert bars["mass"] == pytest.approx(0.8 * 1000 * 0.05 * 0.07**2, abs=1e-6)
    n_frames = len(list(frames(tmp_path / "tracks-check.mp4")))
    assert f"{n_frames} frames" in said and "dropped by the camera" in said and "3 throws, lost in" in said
    assert "in 2 throws the bar is lost from sight inside the tank" in said  # the third ends with the video
    assert ("views of the board" in said) == lens
    assert sorted(path.name for path in tmp_path.iterdir()) == ["tracks-bars.csv", "tracks-check.mp4", "tracks.csv"]


def test_the_angle_of_a_small_tag_has_no_bias(tank):
    """A robot's tag has 22 pixels. Noise of a quarter of a pixel in each corner turns it by 0.25 / 15.5 / √4 rad, 0.5°.

    A corner that is sought too near to where the outline of the tag was first seen stays there: this turns the tag by
    up to 1.5°, to the left at 20° and to the right at 70°.
    """
    from synthetic_tank import sticker

    size, scene = tank.scene.markers.robot.tag_size, tank.scene
    plane = scene.camera.plane(scene.middle, scene.behind)
    at, errors = tag_corners(size, 0.0, 0.0), []
    for degrees in range(0, 360, 10):
        pose = np.array([0.2, 0.1, np.radians(degrees)])
        pixels = find_tags(scene.markers, scene.shot([(sticker(20, size), pose[None])]), "picture")[20]
        turned = fit_bar(at, plane.metres(pixels), plane.jacobian(pixels)).pose[2] - pose[2]
        errors.append(np.degrees((turned + np.pi) % (2 * np.pi) - np.pi))
    assert np.sqrt(np.square(errors).mean()) < 0.5


@pytest.mark.parametrize(
    ("shown", "rate"),
    [
        (lambda n: [i // 3 for i in range(3 * n)], 60.0),  # a phone writes 180 pictures a second, of which 60 are new
        (lambda n: [i - i % 12 + 5 if i % 12 in (6, 7) else i for i in range(n)], 60.0),  # it hangs for two frames
        (lambda n: list(range(n)), None),
    ],
)
def test_pictures_that_repeat_are_left_out_and_counted(tank, tmp_path, shown, rate, capsys):
    pictures = [frame.picture for frame in frames(tank.folder / "throws.mp4")]
    order = shown(len(pictures))
    again = tmp_path / "again.mp4"
    with film(again, width=640, height=368, rate=60 * len(order) / len(pictures), quality=20) as add:
        for i in order:
            add(pictures[i])
    assert call("track", again, "--markers", tank.folder / "markers.yaml", "--out", tmp_path / "tracks.csv") == 0
    said = r"\d+ frames repeat the one before, and are left out: ([\d.]+) a second are new"
    rates = re.findall(said, capsys.readouterr().out)
    if rate is None:
        assert rates == []
        return
    assert list(map(float, rates)) == pytest.approx([rate], rel=0.01)
    frame = np.round(table(tmp_path / "tracks.csv")["time"] * 60 * len(order) / len(pictures)).astype(int)
    repeats = np.isin(frame, np.flatnonzero(np.diff(order, prepend=-1) == 0))
    assert repeats.mean() < 0.05


def test_slow_motion_is_made_real_time(tank, tmp_path):
    assert track(tank, tmp_path / "tracks.csv", "--slowdown", "4", "--set", "bars=[]", "--robot") == 2  # no robot in it
    assert track(tank, tmp_path / "tracks.csv", "--slowdown", "2") == 0
    assert np.diff(table(tmp_path / "tracks.csv")["time"]).min() == pytest.approx(1 / 120, abs=1e-4)


def exchanged(tags):
    return [{**tag, "number": other["number"]} for tag, other in zip(tags, tags[::-1], strict=True)]


def wider(corners):
    return [{**corner, "x": corner["x"] * 1.1} for corner in corners]


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        ("tank.corners.2.number", 49, "tag 49 of the tank is seen in no frame of 0 to"),
        ("tank.corners.2.x", 0.45, "the tank's tags do not lie where the markers file says"),
        ("bars.0.tags.0.number", 0, "tag 0 is on two things"),
        ("bars.0.tags", exchanged, "see that no two tags were exchanged"),
        ("tank.corners", wider, "measure its tags (size, along, across) and the tank's"),
        ("tank.waterline", 5.0, "waterline is 5, expected a height between those of the tank's tags"),
        ("dictionary", "apriltag_36h11", "expected tags of the markers file, found none"),
        ("bars", [], "expected at least one throw, found none"),
    ],
)
def test_a_markers_file_that_does_not_fit(tank, tmp_path, place, value, message, capsys):
    part = document = yaml.safe_load((tank.folder / "markers.yaml").read_text())
    *parents, last = (int(key) if key.isdigit() else key for key in place.split("."))
    for key in parents:
        part = part[key]
    part[last] = value(part[last]) if callable(value) else value
    markers = tmp_path / "changed.yaml"
    markers.write_text(yaml.safe_dump(document))
    assert call("track", tank.folder / "throws.mp4", "--markers", markers, "--out", tmp_path / "tracks.csv") == 2
    said = capsys.readouterr().err
    assert message in said and len(said.strip().splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["changed.yaml"]


def written(path, pictures):
    with film(path, width=pictures[0].shape[1], height=pictures[0].shape[0], rate=30, quality=18) as add:
        for picture in pictures:
            add(picture)
    return path


def twice(tank, folder):
    first, second = (frame.picture.copy() for frame in islice(frames(tank.folder / "throws.mp4"), 2))
    second[60:150, 250:350] = second[268:358, 15:115]  # the tag at the lower left
    return written(folder / "twice.mp4", [first, second])


def knocked(tank, folder):
    pictures = [frame.picture for frame in islice(frames(tank.folder / "throws.mp4"), 8)]
    return written(folder / "knocked.mp4", pictures[:4] + [np.roll(picture, 5, axis=1) for picture in pictures[4:]])


def cut(tank, folder):
    whole = (tank.folder / "throws.mp4").read_bytes()
    (folder / "cut.mp4").write_bytes(whole[: len(whole) // 2])
    return folder / "cut.mp4"


def test_a_thumbnail_before_the_video_is_passed_over(tank, tmp_path):
    import av

    path, pictures = tmp_path / "cover.mp4", [frame.picture for frame in frames(tank.folder / "throws.mp4")]
    with av.open(str(path), "w") as file:
        streams = [file.add_stream(codec, rate=30) for codec in ("mjpeg", "libx264")]
        for stream, size, form in zip(streams, ((64, 48), (640, 368)), ("yuvj420p", "yuv420p"), strict=True):
            stream.width, stream.height, stream.pix_fmt = *size, form
        streams[0].disposition = av.stream.Disposition.attached_pic
        file.mux(streams[0].encode(av.VideoFrame.from_ndarray(pictures[0][:48, :64].copy(), format="gray")))
        file.mux(streams[0].encode())
        for picture in pictures[:5]:
            file.mux(streams[1].encode(av.VideoFrame.from_ndarray(picture, format="gray")))
        file.mux(streams[1].encode())
    assert [frame.picture.shape for frame in frames(path)] == 5 * [(368, 640)]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (twice, r"twice.mp4: frame 1: tag \d+ is seen twice, at \("),
        (knocked, r"moved by 5\."),
        (lambda tank, folder: folder / "missing.mp4", "missing.mp4.*Is there such a file"),
        (cut, "cut.mp4.*can't be read as a video"),
    ],
)
def test_videos_that_are_refused(tank, tmp_path, make, message, capsys):
    arguments = ("track", make(tank, tmp_path), "--markers", tank.folder / "markers.yaml")
    said = refused(capsys, *map(str, arguments), "--out", str(tmp_path / "tracks.csv"))
    assert re.search(message, said) and not (tmp_path / "tracks.csv").exists()


def test_a_pose_that_is_not_finite_is_one_frame_lost(tank, tmp_path, monkeypatch):
    fits = iter(range(10_000))

    def fit(*arguments):
        pose = fit_bar(*arguments)
        return replace(pose, pose=np.full(3, np.nan), chi2=np.nan) if next(fits) == 7 else pose

    assert track(tank, tmp_path / "all.csv") == 0
    monkeypatch.setattr(track_video, "fit_bar", fit)
    assert track(tank, tmp_path / "tracks.csv") == 0
    every, tracks = table(tmp_path / "all.csv"), table(tmp_path / "tracks.csv")
    assert len(tracks) == len(every) - 1 and all(np.isfinite(tracks[name]).all() for name in tracks.dtype.names)


def test_boards_that_are_refused(tank, tmp_path, capsys):
    board = [frame.picture for frame in frames(tank.folder / "board.mp4")]
    for name, pictures, message in (
        ("small", [picture[:240, :320] for picture in board], "at least 8 corners in at least 6 frames"),
        ("still", 8 * board[:1], "6 frames that differ, got 1 of 8"),
        ("large", [np.pad(picture, ((0, 32), (0, 0))) for picture in board], "640 × 400"),
    ):
        video = written(tmp_path / f"{name}.mp4", pictures)
        assert track(tank, tmp_path / "tracks.csv", "--lens", video) == 2
        assert message in capsys.readouterr().err


def test_what_is_refused_at_once(tank, tmp_path, monkeypatch, capsys):
    for out in (tmp_path / "tracks.txt", tmp_path / "none" / "tracks.csv"):
        assert track(tank, out) == 2
        assert "--out: expected a file name that ends in .csv" in capsys.readouterr().err
    for name in ("cv2", "cv2.aruco"):
        monkeypatch.setitem(sys.modules, name, None)  # as if it were not installed
    assert track(tank, tmp_path / "tracks.csv") == 2
    assert "make setup EXTRAS=vision" in capsys.readouterr().err
