"""The servo log: what was sent to which servo, when, and how late, as CSV.

Every row is written at once, so that even a killed process leaves its record, though not a power failure.
"""

import csv
from contextlib import suppress
from dataclasses import astuple, dataclass, fields
from datetime import datetime
from pathlib import Path
from typing import Self

from pipeline.errors import PuddleError


@dataclass(frozen=True)
class LogEntry:
    """A command to one servo, a reading of one, or an event of the whole run. What is missing is empty in the file."""

    time: float  # time since the run began, by the host's monotonic clock [s]
    event: str = ""
    """Empty for a pulse; "position" or "off"; or how the run began or ended, in words."""
    frame: int | None = None  # frame of the timeline
    channel: int | None = None
    wanted: float | None = None  # pulse that the timeline asked for [µs]
    sent: float | None = None  # pulse that was sent [µs]; 0 is off
    position: float | None = None  # pulse that the controller reported [µs]; 0 is off
    lateness: float | None = None  # delay of the command behind the timeline [s]


class ServoLog:
    """A log file that gets each entry at once."""

    def __init__(self, path: Path) -> None:
        """Start a log. Raises PuddleError if the file exists or can't be written."""
        try:
            self._file = path.open("x", encoding="utf-8", newline="", buffering=1)
        except OSError as error:
            advice = "Choose another name with --log; nothing was moved"
            raise PuddleError(f"{path}: writing the log failed: {error.strerror}. {advice}.") from None
        self._rows = csv.writer(self._file, lineterminator="\n")
        self._rows.writerow(field.name for field in fields(LogEntry))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):  # a full disk was reported when the entry was added
            self._file.close()

    def add(self, *entries: LogEntry) -> None:
        """Write entries."""
        self._rows.writerows(astuple(entry) for entry in entries)


def default_path(folder: Path) -> Path:
    """Return the path of a log that is started now and has no name of its own."""
    return folder / f"{datetime.now():servo-%Y%m%d-%H%M%S.csv}"
