"""The servo log: what was sent to which servo, when, and how late, as Parquet.

During a run every row is written to a journal beside the log at once, so that even a killed process leaves a record.
The next run that logs into the same folder turns such a journal into Parquet.
"""

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from pipeline.store import disk
from pipeline.store.encoding import encode_table
from pipeline.store.tables import columns_of

JOURNAL = ".journal"  # suffix of the file that holds the rows until the log is closed


@dataclass(frozen=True)
class LogEntry:
    """A command to one servo, a reading of one, or an event of the whole run."""

    time: float  # time since the run began, by the host's monotonic clock [s]
    event: str = ""
    """Empty for a pulse; "at most N µs/s", "position", "off" or "home"; or how the run began or ended, in words."""
    frame: int = -1  # frame of the timeline; -1 outside it
    channel: int = -1  # channel; -1 for the whole run
    wanted: float | None = None  # pulse that the timeline asked for [µs]
    sent: float | None = None  # pulse that was sent [µs]; 0 is off
    position: float | None = None
    """Pulse that the controller reported [µs]; 0 is off. Only in "position" rows."""
    lateness: float | None = None  # delay of the command behind the timeline [s]


class ServoLog:
    """Log that writes each entry to the journal at once, and a Parquet file when it is closed."""

    def __init__(self, path: Path) -> None:
        """Start a log. Raises PuddleError if the folder is not writable or the log exists."""
        self.path = path
        self.entries: list[LogEntry] = []
        self._journal = path.with_name(path.name + JOURNAL)
        with disk.explained("writing the log", path, advice="run the same command again; nothing was moved"):
            path.parent.mkdir(parents=True, exist_ok=True)
            _recover_abandoned(path.parent)
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
            self._descriptor = os.open(self._journal, flags, 0o644)
            self._lock = disk.try_lock(self._journal)

    def add(self, *entries: LogEntry) -> None:
        """Record entries so that they survive the death of this process, though not a power failure."""
        self.entries += entries
        lines = "".join(json.dumps(asdict(entry), allow_nan=False) + "\n" for entry in entries)
        os.write(self._descriptor, lines.encode())

    def close(self) -> None:
        """Write the Parquet file and remove the journal. Raises PuddleError if that fails; then the journal stays."""
        os.close(self._descriptor)
        advice = f"play the timeline again: the next log in that folder also converts {self._journal}"
        try:
            with disk.explained("writing the log", self.path, advice=advice):
                disk.place(self.path, _encode(self.entries))
                disk.unlink(self._journal)
        finally:
            if self._lock is not None:
                os.close(self._lock)


def _encode(entries: Sequence[LogEntry]) -> bytes:
    units = {"time": "s", "lateness": "s", "wanted": "µs", "sent": "µs", "position": "µs"}
    return encode_table(columns_of(LogEntry, entries), schema="servo_log", version=1, producer="servo", units=units)


def _recover_abandoned(folder: Path) -> None:
    """Convert journals that no living process has locked."""
    for journal in sorted(folder.glob(f"*{JOURNAL}")):
        lock = disk.try_lock(journal)
        if lock is not None:
            rows = disk.read(journal, at_most=journal.stat().st_size)  # hours of frames exceed the default limit
            disk.place(journal.with_name(journal.name.removesuffix(JOURNAL)), _encode(_decode_journal(rows)))
            disk.unlink(journal)
            os.close(lock)


def _decode_journal(journal: bytes) -> list[LogEntry]:
    """Read a journal up to its last complete line."""
    names = {field.name for field in fields(LogEntry)}
    entries = []
    for line in journal.split(b"\n")[:-1]:
        try:
            row = json.loads(line)
        except ValueError:
            break
        if not isinstance(row, dict) or set(row) != names:
            break
        entries.append(LogEntry(**row))
    return entries
