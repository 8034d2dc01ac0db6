"""File formats of servo timelines (timeline.json, timeline.csv) and calibrations (calibration.yaml)."""

from pathlib import Path
from typing import Any

import numpy as np

from pipeline.config.loading import load
from pipeline.errors import PuddleError
from pipeline.store.encoding import check_format, decode_json, encode_json
from tasks.design import N_LINKS
from tasks.fabrication.calibration import Calibration, ServoCalibration
from tasks.fabrication.timeline import FRAME_RATE_HZ, Timeline, TimelineError, pulses

_SCHEMA, _VERSION = "puddle.timeline", 1
_FIELDS = {"schema", "version", "frames_per_second", "joints", "angle", "channels", "pulse_us"}

MAX_TIMELINE_BYTES = 2**24  # largest timeline file, which holds hours of five joints

_RADIAN_DIGITS, _PULSE_DIGITS = 6, 2  # decimals, far finer than any servo


def timeline_json(timeline: Timeline, calibration: Calibration) -> bytes:
    """Encode a timeline, with its pulses under a calibration, as JSON. Raises TimelineError beyond its limits."""
    sent = np.round(pulses(timeline, calibration), _PULSE_DIGITS)
    return encode_json(
        {
            "schema": _SCHEMA,
            "version": _VERSION,
            "frames_per_second": FRAME_RATE_HZ,
            "joints": list(timeline.joints),
            "angle": np.round(timeline.angle.T, _RADIAN_DIGITS).tolist(),
            "channels": [servo.channel for servo in calibration.servos],
            "pulse_us": sent.T.tolist(),
        }
    )


def timeline_csv(timeline: Timeline, calibration: Calibration) -> bytes:
    """Encode the same as CSV, one row per frame. Raises as :func:`timeline_json`."""
    sent = pulses(timeline, calibration)
    angles = [f"joint_{joint}_rad" for joint in timeline.joints]
    widths = [f"channel_{servo.channel}_us" for servo in calibration.servos]
    decimals = [2, *len(angles) * [_RADIAN_DIGITS], *len(widths) * [_PULSE_DIGITS]]
    row = ",".join(f"{{:.{n}f}}" for n in decimals)
    table = np.column_stack([timeline.time, timeline.angle, sent])
    lines = [",".join(["time_s", *angles, *widths]), *(row.format(*values) for values in table)]
    return "".join(f"{line}\n" for line in lines).encode()


def read_timeline(path: Path) -> Timeline:
    """Read a timeline's angles. The pulses follow from the current calibration, so those of the file are ignored.

    Raises PuddleError if the file can't be read or is invalid; the message names the field.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_TIMELINE_BYTES + 1)
    except OSError as error:
        raise PuddleError(f"{path}: can't read the timeline: {error.strerror}") from None
    if len(data) > MAX_TIMELINE_BYTES:
        raise PuddleError(f"{path}: expected a timeline of at most {MAX_TIMELINE_BYTES} bytes. Is it the right file?")
    document = decode_json(data, str(path))
    check_format(document, schema=_SCHEMA, version=_VERSION, source=str(path))
    if wrong := sorted(document.keys() ^ _FIELDS):
        problem = "missing" if wrong[0] in _FIELDS else "unknown"
        raise PuddleError(f"{path}: field {wrong[0]} is {problem}, expected {', '.join(sorted(_FIELDS))}")
    if document["frames_per_second"] != FRAME_RATE_HZ:
        raise PuddleError(
            f"{path}: frames_per_second: expected {FRAME_RATE_HZ:g}, got {document['frames_per_second']!r}"
        )
    joints = document["joints"]
    if not _are_joints(joints):
        raise PuddleError(f"{path}: joints: expected distinct numbers from 1 to {N_LINKS - 1}, got {joints!r}")
    angle = document["angle"]
    if not _are_columns(angle, len(joints)):
        raise PuddleError(f"{path}: angle: expected {len(joints)} lists of numbers of equal length, one per joint")
    try:
        return Timeline(joints=tuple(joints), angle=np.array(angle, dtype=np.float64).T)
    except OverflowError:
        raise PuddleError(f"{path}: angle: a number is too large") from None
    except TimelineError as error:
        raise PuddleError(f"{path}: {error}") from None


def _are_joints(joints: Any) -> bool:
    return (
        isinstance(joints, list)
        and all(type(joint) is int and 0 < joint < N_LINKS for joint in joints)
        and len(set(joints)) == len(joints)
    )


def _are_columns(columns: Any, n_columns: int) -> bool:
    return (
        isinstance(columns, list)
        and len(columns) == n_columns
        and all(isinstance(column, list) and all(type(v) in (int, float) for v in column) for column in columns)
        and len({len(column) for column in columns}) == 1
    )


def read_calibration(path: Path) -> Calibration:
    """Read a calibration from YAML or JSON. Raises PuddleError with a line per mistake."""
    try:
        return load(Calibration, path)
    except PuddleError as error:
        if isinstance(error.__cause__, OSError):  # whose message speaks of settings
            raise PuddleError(f"{path}: can't read the calibration file: {error.__cause__.strerror}") from error
        raise


def calibration_yaml(calibration: Calibration, heading: str) -> bytes:
    """Encode a calibration as YAML with comments, for the user to edit."""
    lines = [*(f"# {line}" for line in heading.splitlines()), "servos:"]
    for servo in calibration.servos:
        for number, (name, field) in enumerate(ServoCalibration.model_fields.items()):
            mark = " " if number else "-"
            lines.append(f"  {mark} {name}: {getattr(servo, name):.10g}  # {field.description}")
    return ("\n".join(lines) + "\n").encode()
