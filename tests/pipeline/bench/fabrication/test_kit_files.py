"""A kit's folder, timelines and calibrations: round trips, and messages that name file and field."""

import json
from functools import partial

import numpy as np
import pytest

from pipeline.bench.fabrication.kit_files import (
    KIT,
    KIT_MANIFEST,
    calibration_yaml,
    read_timeline,
    timeline_json,
    write_folder,
)
from pipeline.config.loading import load
from pipeline.errors import PuddleError
from tasks.bench.fabrication.calibration import Calibration, ServoCalibration
from tasks.bench.fabrication.timeline import Timeline, pulses

COMMON = {"us_per_rad": 600.0, "min_us": 900.0, "max_us": 2100.0, "max_speed": 5.5}
CALIBRATION = Calibration(
    servos=(
        ServoCalibration(joint=2, channel=0, centre_us=1500.0, direction=1, **COMMON),
        ServoCalibration(joint=5, channel=7, centre_us=1511.25, direction=-1, **COMMON),
    )
)
TIMELINE = Timeline(joints=(2, 5), angle=np.stack([np.linspace(0, 0.9, 50), np.linspace(0.3, -0.8, 50)], axis=1))


def test_a_timeline_round_trip(tmp_path):
    path = tmp_path / "timeline.json"
    path.write_bytes(timeline_json(TIMELINE, CALIBRATION))
    back, said = read_timeline(path), json.loads(path.read_text())
    assert back.joints == TIMELINE.joints and said["channels"] == [0, 7]
    np.testing.assert_allclose(back.angle, TIMELINE.angle, rtol=0, atol=0.5e-6)
    np.testing.assert_allclose(np.array(said["pulse_us"]).T, pulses(TIMELINE, CALIBRATION), rtol=0, atol=0.005)


def test_a_calibration_round_trip(tmp_path):
    path = tmp_path / "calibration.yaml"
    path.write_bytes(calibration_yaml(CALIBRATION, "The test robot.\nMeasure it."))
    assert load(Calibration, path) == CALIBRATION


GOOD = calibration_yaml(CALIBRATION, "good").decode()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("min_us: 900", "min_us: 2200"), "calibration.yaml: servos[0]: min_us is 2200 and max_us is 2100"),
        (("us_per_rad: 600", "us_per_rad: .nan"), "servos[0].us_per_rad: expected a finite number"),
        (("centre_us: 1500", "center_us: 1500"), "center_us: unknown setting; did you mean servos[0].centre_us?"),
        (("channel: 7", "channel: 0"), "channel 0 appears twice"),
        (("direction: -1", "direction: 0"), "servos[1].direction"),
        ({"joints": [2, 19]}, "joints.1: Input should be less than 12"),
        ({"joints": [2]}, "angles have shape (50, 2), expected (n_frames, 1)"),
        ({"angle": [[0.0], [0.0, 1.0]]}, "angle: "),
        ({"angle": [[0.0], ["up"]]}, "angle.1.0: Input should be a valid number"),
        ({"frames_per_second": 60}, "frames_per_second: Input should be 50"),
        ({"version": 2}, "version 2"),
        ({"schema": "puddle.design"}, "puddle.design"),
        ({"speed": 3}, "speed: Extra inputs are not permitted"),
    ],
)
def test_invalid_files_are_refused(tmp_path, change, said):
    if isinstance(change, dict):
        path, read = tmp_path / "timeline.json", read_timeline
        path.write_text(json.dumps({**json.loads(timeline_json(TIMELINE, CALIBRATION)), **change}))
    else:
        path, read = tmp_path / "calibration.yaml", partial(load, Calibration)
        path.write_text(GOOD.replace(*change, 1))
    with pytest.raises(PuddleError) as refusal:
        read(path)
    assert str(path) in str(refusal.value) and said in str(refusal.value)


@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_folder_that_is_not_completed_leaves_the_earlier_one(failure, tmp_path):
    folder = tmp_path / "kit"
    write_folder(KIT, folder, {"a.txt": b"old"}, {"name": "old"})
    with pytest.raises((OSError, KeyboardInterrupt)), KIT.replace(folder, {"name": "new"}) as new:
        new.write("a.txt", b"new")
        raise failure
    assert (folder / "a.txt").read_bytes() == b"old" and [path.name for path in tmp_path.iterdir()] == ["kit"]


def test_files_of_the_user_are_preserved(tmp_path):
    folder = tmp_path / "kit"
    write_folder(KIT, folder, {"calibration.yaml": b"a guess", "print/gone.stl": b"part"}, {"name": "old"})
    for content in (b"measured", b"measured again"):
        (folder / "calibration.yaml").write_bytes(content)
        (folder / "servo-1.csv").write_bytes(b"log")
        lines = write_folder(KIT, folder, {"calibration.yaml": b"another guess"}, {"name": "new"})
    assert lines == ["Preserved calibration.yaml, which you had changed, as calibration-2.yaml."]
    held = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    held.pop(KIT_MANIFEST)
    assert held == {
        "calibration.yaml": b"another guess",
        "calibration-1.yaml": b"measured",
        "calibration-2.yaml": b"measured again",
        "servo-1.csv": b"log",
    }


def test_folders_that_are_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(PuddleError, match="found a file"):
        KIT.check_place(tmp_path / "file")
    (tmp_path / "newer").mkdir()
    (tmp_path / "newer" / KIT_MANIFEST).write_text('{"schema": "puddle.kit", "version": 9}')
    with pytest.raises(PuddleError, match="version 9"):
        KIT.check_place(tmp_path / "newer")
    (tmp_path / "empty").mkdir()
    assert KIT.check_place(tmp_path / "empty") == tmp_path / "empty"
