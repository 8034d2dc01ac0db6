"""timeline.json and timeline.csv: how a servo timeline travels, and calibration.yaml beside it."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.config.loading import load
from pipeline.errors import PuddleError
from pipeline.store.encoding import check_format, decode_json, encode_json
from tasks.design import N_LINKS
from tasks.fabrication.calibration import Calibration
from tasks.fabrication.timeline import FRAME_RATE_HZ, Timeline, TimelineError, pulses

_SCHEMA, _VERSION = "puddle.timeline", 1
FIELDS = {"schema", "version", "frames_per_second", "joints", "angle", "channels", "pulse_us"}

MAX_TIMELINE_BYTES = 2**24
"""A timeline file's greatest length: hours of five joints."""

RADIAN_DIGITS, PULSE_DIGITS = 6, 2
"""Decimals that a timeline is written with: far finer than any servo."""


def timeline_json(timeline: Timeline, calibration: Calibration) -> bytes:
    """Write a timeline, with the pulses that a calibration makes of it.

    Raises:
        TimelineError: it is past a limit of the calibration.
    """
    sent = np.round(pulses(timeline, calibration), PULSE_DIGITS)
    return encode_json(
        {
            "schema": _SCHEMA,
            "version": _VERSION,
            "frames_per_second": FRAME_RATE_HZ,
            "joints": list(timeline.joints),
            "angle": np.round(timeline.angle.T, RADIAN_DIGITS).tolist(),
            "channels": [servo.channel for servo in calibration.servos],
            "pulse_us": sent.T.tolist(),
        }
    )


def timeline_csv(timeline: Timeline, calibration: Calibration) -> bytes:
    """Write the same as a sheet: a row for each frame. Raises as timeline_json."""
    sheet = io.StringIO()
    writer = csv.writer(sheet, lineterminator="\n")
    writer.writerow(
        [
            "time_s",
            *(f"joint_{joint}_rad" for joint in timeline.joints),
            *(f"channel_{servo.channel}_us" for servo in calibration.servos),
        ]
    )
    for time, angle, sent in zip(timeline.time, timeline.angle, pulses(timeline, calibration), strict=True):
        row = [f"{time:.2f}", *(f"{value:.{RADIAN_DIGITS}f}" for value in angle)]
        writer.writerow([*row, *(f"{value:.{PULSE_DIGITS}f}" for value in sent)])
    return sheet.getvalue().encode()


def read_timeline(path: Path) -> Timeline:
    """Read a timeline's angles. Its pulses are left alone: they follow from the calibration at hand.

    Raises:
        PuddleError: the file can't be read or is no timeline; names the field.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_TIMELINE_BYTES + 1)
    except OSError as error:
        raise PuddleError(f"{path}: can't be read: {error.strerror}. Expected a timeline (timeline.json).") from None
    if len(data) > MAX_TIMELINE_BYTES:
        raise PuddleError(
            f"{path}: expected at most {MAX_TIMELINE_BYTES} bytes of a timeline, came more. Is it the right file?"
        )
    document = decode_json(data, str(path))
    check_format(document, schema=_SCHEMA, version=_VERSION, source=str(path))
    if strangers := sorted(document.keys() ^ FIELDS):
        raise PuddleError(f"{path}: expected the fields {', '.join(sorted(FIELDS))}; {strangers[0]} is amiss")
    if document["frames_per_second"] != FRAME_RATE_HZ:
        raise PuddleError(
            f"{path}: frames_per_second: expected {FRAME_RATE_HZ:g}, came {document['frames_per_second']!r}"
        )
    joints = document["joints"]
    if not _are_joints(joints):
        raise PuddleError(f"{path}: joints: expected numbers from 1 to {N_LINKS - 1}, each once, came {joints!r}")
    angle = document["angle"]
    if not _are_columns(angle, len(joints)):
        raise PuddleError(f"{path}: angle: expected {len(joints)} lists of numbers, one a joint, equally long")
    try:
        return Timeline(joints=tuple(joints), angle=np.array(angle, dtype=np.float64).T)
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
    """Read a calibration, YAML or JSON.

    Raises:
        PuddleError: one line for each mistake, with its line and field.
    """
    return load(Calibration, path)


def calibration_yaml(calibration: Calibration, heading: str) -> bytes:
    """Write a calibration for a person to edit."""
    lines = [*(f"# {line}" for line in heading.splitlines()), "servos:"]
    for servo in calibration.servos:
        values = servo.model_dump()
        marks = ["-"] + [" "] * (len(values) - 1)
        for mark, (name, value) in zip(marks, values.items(), strict=True):
            lines.append(f"  {mark} {name}: {value:.10g}" + (f"  # {_COMMENTS[name]}" if name in _COMMENTS else ""))
    return ("\n".join(lines) + "\n").encode()


_COMMENTS = {
    "joint": "the joint that it moves, by the number of its child link",
    "channel": "of the controller",
    "centre_us": "pulse at which the joint rests",
    "direction": "1 or -1: whether longer pulses turn the child counter-clockwise",
    "us_per_rad": "pulse for a radian",
    "min_us": "shortest pulse that it is ever sent",
    "max_us": "longest",
    "max_speed": "rad/s",
}
