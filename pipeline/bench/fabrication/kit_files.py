"""What others read of a kit: its manifest, timeline.json of its servos, and calibration.yaml."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationError

from pipeline.errors import PuddleError
from pipeline.store.encoding import Json, decode_document, encode_document
from pipeline.store.owned_folder import FolderKind
from tasks.bench.fabrication.calibration import Calibration, ServoCalibration
from tasks.bench.fabrication.timeline import FRAME_RATE_HZ, Timeline, pulses
from tasks.design import MOST_LINKS
from tasks.parameters import Parameters

KIT_MANIFEST = "kit.json"  # makes a folder a kit: schema, source, findings and the SHA-256 of every other file
KIT = FolderKind("a kit", "puddle.kit", 2, KIT_MANIFEST)

_SCHEMA, _VERSION = "puddle.timeline", 1
_RADIAN_DIGITS, _PULSE_DIGITS = 6, 2  # decimals, far finer than any servo

_Columns = tuple[tuple[float, ...], ...]  # a list of numbers per joint or servo


class _TimelineDocument(Parameters):
    schema_name: str = Field(alias="schema")
    version: int
    frames_per_second: Literal[50]
    joints: tuple[Annotated[int, Field(ge=1, lt=MOST_LINKS)], ...]
    angle: _Columns
    channels: tuple[int, ...]
    pulse_us: _Columns


def write_folder(kind: FolderKind, folder: Path, files: Mapping[str, bytes], manifest: Mapping[str, Json]) -> list[str]:
    """Write files and their manifest as a folder of a kind. Return a line per file of the user that was preserved."""
    with kind.replace(folder, manifest) as new:
        for name, content in files.items():
            new.write(name, content)
    return new.preserved


def timeline_json(timeline: Timeline, calibration: Calibration) -> bytes:
    """Encode a timeline, with its pulses under a calibration, as JSON. Raises TimelineError beyond its limits."""
    sent = np.round(pulses(timeline, calibration), _PULSE_DIGITS)
    document = {
        "frames_per_second": FRAME_RATE_HZ,
        "joints": list(timeline.joints),
        "angle": np.round(timeline.angle.T, _RADIAN_DIGITS).tolist(),
        "channels": [servo.channel for servo in calibration.servos],
        "pulse_us": sent.T.tolist(),
    }
    return encode_document(document, schema=_SCHEMA, version=_VERSION)


def read_timeline(path: Path) -> Timeline:
    """Read a timeline's angles. The pulses follow from the current calibration, so those of the file are ignored.

    Raises PuddleError if the file can't be read or is invalid; the message names the field.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise PuddleError(f"{path}: can't read the timeline: {error.strerror}") from None
    document = decode_document(data, schema=_SCHEMA, version=_VERSION, source=str(path))
    try:
        read = _TimelineDocument.model_validate(document)
        return Timeline(joints=read.joints, angle=np.array(read.angle).T)
    except ValidationError as error:
        first = error.errors()[0]
        raise PuddleError(f"{path}: {'.'.join(map(str, first['loc']))}: {first['msg']}") from None
    except ValueError as error:
        raise PuddleError(f"{path}: angle: {error}") from None


def calibration_yaml(calibration: Calibration, heading: str) -> bytes:
    """Encode a calibration as YAML with comments, for the user to edit."""
    lines = [*(f"# {line}" for line in heading.splitlines()), "servos:"]
    for servo in calibration.servos:
        for number, (name, field) in enumerate(ServoCalibration.model_fields.items()):
            mark = " " if number else "-"
            lines.append(f"  {mark} {name}: {getattr(servo, name):.10g}  # {field.description}")
    return ("\n".join(lines) + "\n").encode()
