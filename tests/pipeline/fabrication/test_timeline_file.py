"""Files of timelines and calibrations: round trips, and messages that name file and field."""

import csv
import io
import json

import numpy as np
import pytest

from pipeline.errors import PuddleError
from pipeline.fabrication.timeline_file import (
    MAX_TIMELINE_BYTES,
    calibration_yaml,
    read_calibration,
    read_timeline,
    timeline_csv,
    timeline_json,
)
from tasks.fabrication.calibration import Calibration, ServoCalibration
from tasks.fabrication.timeline import Timeline, pulses

CALIBRATION = Calibration(
    servos=(
        ServoCalibration(
            joint=2,
            channel=0,
            centre_us=1500.0,
            direction=1,
            us_per_rad=636.62,
            min_us=500.0,
            max_us=2500.0,
            max_speed=6.0,
        ),
        ServoCalibration(
            joint=5,
            channel=7,
            centre_us=1511.25,
            direction=-1,
            us_per_rad=600.0,
            min_us=900.0,
            max_us=2100.0,
            max_speed=5.5,
        ),
    )
)
TIMELINE = Timeline(joints=(2, 5), angle=np.stack([np.linspace(0, 0.9, 50), np.linspace(0.3, -0.8, 50)], axis=1))


def test_a_timeline_round_trip(tmp_path):
    path = tmp_path / "timeline.json"
    path.write_bytes(timeline_json(TIMELINE, CALIBRATION))
    back = read_timeline(path)
    assert back.joints == TIMELINE.joints
    np.testing.assert_allclose(back.angle, TIMELINE.angle, rtol=0, atol=0.5e-6)
    said = json.loads(path.read_text())
    np.testing.assert_allclose(np.array(said["pulse_us"]).T, pulses(TIMELINE, CALIBRATION), rtol=0, atol=0.005)
    assert said["channels"] == [0, 7]


def test_the_csv_equals_the_timeline():
    rows = list(csv.reader(io.StringIO(timeline_csv(TIMELINE, CALIBRATION).decode())))
    assert rows[0] == ["time_s", "joint_2_rad", "joint_5_rad", "channel_0_us", "channel_7_us"]
    table = np.array(rows[1:], dtype=float)
    np.testing.assert_allclose(table[:, 0], np.arange(50) / 50)
    np.testing.assert_allclose(table[:, 1:3], TIMELINE.angle, rtol=0, atol=0.5e-6)
    np.testing.assert_allclose(table[:, 3:], pulses(TIMELINE, CALIBRATION), rtol=0, atol=0.005)


def test_a_calibration_round_trip(tmp_path):
    path = tmp_path / "calibration.yaml"
    path.write_bytes(calibration_yaml(CALIBRATION, "The test robot.\nMeasure it."))
    assert read_calibration(path) == CALIBRATION
    as_json = tmp_path / "calibration.json"
    as_json.write_text(CALIBRATION.model_dump_json(indent=2))
    assert read_calibration(as_json) == CALIBRATION


GOOD = calibration_yaml(CALIBRATION, "good").decode()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("min_us: 900", "min_us: 2200", ":11: servos[1]: min_us is 2200 and max_us is 2100"),
        ("us_per_rad: 600", "us_per_rad: .nan", ":14: servos[1].us_per_rad: expected a number"),
        ("us_per_rad: 600", "us_per_rad: NaN", ":14: servos[1].us_per_rad: expected a number"),
        ("centre_us: 1500", "center_us: 1500", "center_us: unknown setting; did you mean centre_us?"),
        ("channel: 7", "channel: 0", "channel 0 appears twice"),
        ("channel: 7", "channel: seven", ":12: servos[1].channel: expected a whole number"),
        ("direction: -1", "direction: 0", ":14: servos[1].direction"),
        ("max_speed: 6", "max_speed: -6", "max_speed: expected a number greater than 0"),
    ],
)
def test_invalid_calibrations_are_refused(tmp_path, old, new, said):
    path = tmp_path / "calibration.yaml"
    assert old in GOOD
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(PuddleError) as refusal:
        read_calibration(path)
    assert str(path) in str(refusal.value)
    assert said.split(": ", 1)[-1] in str(refusal.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"joints": [2, 2]}, "joints: expected distinct numbers from 1 to 5"),
        ({"joints": [2, 9]}, "joints"),
        ({"angle": [[0.0], [0.0, 1.0]]}, "angle: expected 2 lists"),
        ({"angle": [[0.0], ["up"]]}, "angle"),
        ({"angle": [[0.0, 10**400], [0.0, 1.0]]}, "angle: a number is too large"),
        ({"angle": [[], []]}, "shape"),
        ({"frames_per_second": 60}, "frames_per_second: expected 50"),
        ({"version": 2}, "version 2"),
        ({"schema": "puddle.design"}, "puddle.design"),
        ({"speed": 3}, "field speed is unknown"),
    ],
)
def test_invalid_timelines_are_refused(tmp_path, change, said):
    path = tmp_path / "timeline.json"
    path.write_text(json.dumps({**json.loads(timeline_json(TIMELINE, CALIBRATION)), **change}))
    with pytest.raises(PuddleError) as refusal:
        read_timeline(path)
    assert str(path) in str(refusal.value) and said in str(refusal.value)


def test_missing_and_damaged_files_are_refused(tmp_path):
    with pytest.raises(PuddleError, match=r"none\.json: can't read the timeline"):
        read_timeline(tmp_path / "none.json")
    (tmp_path / "bad.json").write_text('{"angle": [NaN]}')
    with pytest.raises(PuddleError, match=r"bad\.json"):
        read_timeline(tmp_path / "bad.json")
    (tmp_path / "long.json").write_bytes(b" " * (MAX_TIMELINE_BYTES + 1))
    with pytest.raises(PuddleError, match=r"long\.json: expected a timeline of at most"):
        read_timeline(tmp_path / "long.json")
    with pytest.raises(PuddleError, match=r"none\.yaml"):
        read_calibration(tmp_path / "none.yaml")
