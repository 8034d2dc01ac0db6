"""The log of a drive: what was sent, to whom, when, and how late; Parquet, complete up to whatever ended it.

While servos move, every line goes to a journal beside the log at once, so that even a killed process leaves what it
did: the next drive that logs into the same folder turns such a journal into Parquet.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from pipeline.store import disk
from pipeline.store.encoding import encode_table
from pipeline.store.tables import columns_of

SCHEMA, VERSION = "drive_log", 1
UNITS = {"time": "s", "lateness": "s", "wanted": "µs", "sent": "µs", "position": "µs"}
JOURNAL = ".journal"


@dataclass(frozen=True)
class Entry:
    """A command to one servo, what the controller said of one, or an event of the whole run."""

    time: float
    """Since the drive began [s], by the host's monotonic clock."""
    event: str = ""
    """Empty for a pulse. Else "at most N µs/s", "position", "off" or "home", or in words how the run began or ended."""
    frame: int = -1
    """Of the timeline; -1 before, after and in between."""
    channel: int = -1
    """-1 for what is of the whole run."""
    wanted: float | None = None
    """Pulse that the timeline asked for [µs]."""
    sent: float | None = None
    """Pulse that was sent [µs]; 0 is off."""
    position: float | None = None
    """Pulse that the controller said it gives [µs]; 0 is off. In the rows of the event "position" alone."""
    lateness: float | None = None
    """Of the command, behind the timeline [s]."""


class DriveLog:
    """Collects entries; they are on the disk as they come, and a Parquet file when closed."""

    def __init__(self, path: Path) -> None:
        """Begin a log.

        Raises:
            PuddleError: its folder can't be written to, or the log is there already.
        """
        self.path = path
        self.entries: list[Entry] = []
        self._journal = _journal_of(path)
        with disk.explained("keeping the log", path, advice="give the same command again: nothing was moved"):
            path.parent.mkdir(parents=True, exist_ok=True)
            _recover_abandoned(path.parent)
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
            self._descriptor = os.open(self._journal, flags, 0o644)
            self._lock = disk.try_lock(self._journal)

    def add(self, *entries: Entry) -> None:
        """Note entries, on the disk too: outlives this process, though not the machine's power."""
        self.entries += entries
        lines = "".join(json.dumps(asdict(entry), allow_nan=False) + "\n" for entry in entries)
        os.write(self._descriptor, lines.encode())

    def close(self) -> None:
        """Write the Parquet file, and remove the journal.

        Raises:
            PuddleError: the file can't be written; the journal stays.
        """
        os.close(self._descriptor)
        try:
            again = f"drive again: the next log in that folder makes this one too, of {self._journal}"
            with disk.explained("writing the log", self.path, advice=again):
                disk.place(self.path, encode(self.entries))
                disk.unlink(self._journal)
        finally:
            if self._lock is not None:
                os.close(self._lock)


def encode(entries: Sequence[Entry]) -> bytes:
    """Write entries as Parquet."""
    return encode_table(columns_of(Entry, entries), schema=SCHEMA, version=VERSION, producer="drive", units=UNITS)


def _journal_of(path: Path) -> Path:
    return path.with_name(path.name + JOURNAL)


def _recover_abandoned(folder: Path) -> None:
    """Turn journals that no living process holds into logs."""
    for journal in sorted(folder.glob(f"*{JOURNAL}")):
        lock = disk.try_lock(journal)
        if lock is not None:
            kept = disk.read(journal, at_most=journal.stat().st_size)  # hours of frames: longer than any document
            disk.place(journal.with_name(journal.name.removesuffix(JOURNAL)), encode(_entries(kept)))
            disk.unlink(journal)
            os.close(lock)


def _entries(journal: bytes) -> list[Entry]:
    """Read a journal up to its last whole line."""
    names = {field.name for field in fields(Entry)}
    entries = []
    for line in journal.split(b"\n")[:-1]:
        try:
            said = json.loads(line)
        except ValueError:
            break
        if not isinstance(said, dict) or set(said) != names:
            break
        entries.append(Entry(**said))
    return entries
