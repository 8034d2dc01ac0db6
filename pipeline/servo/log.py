"""The servo log: what was sent to which servo, when, and how late, as Parquet.

During a run every row is written to a journal beside the log at once, so that even a killed process leaves a record.
The next run that logs into the same folder turns such a journal into Parquet. It leaves other files alone: a journal is
a file whose first line is an entry of a log, or whose name only puddle gives, and no file is replaced by its log.
"""

import json
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import datetime
from pathlib import Path
from typing import ClassVar

from pydantic import ConfigDict, TypeAdapter

from pipeline.errors import PuddleError
from pipeline.store import disk
from pipeline.store.encoding import encode_table
from pipeline.store.tables import columns_of

JOURNAL = ".journal"  # suffix of the file that holds the rows until the log is closed
_DAMAGED = ".damaged"  # suffix of a journal that could not be converted
_DEFAULT_NAME = "servo-%Y%m%d-%H%M%S.parquet"
_DEFAULT_JOURNAL = re.compile(rf"servo-\d{{8}}-\d{{6}}\.parquet{re.escape(JOURNAL)}")


def default_path(folder: Path) -> Path:
    """Return the path of a log that is started now and has no name of its own."""
    return folder / f"{datetime.now():{_DEFAULT_NAME}}"


@dataclass(frozen=True)
class LogEntry:
    """A command to one servo, a reading of one, or an event of the whole run."""

    __pydantic_config__: ClassVar = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

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

    def __init__(self, path: Path, say: Callable[[str], None]) -> None:
        """Start a log, and convert the journals beside it that killed runs left.

        Args:
            path: The log to write.
            say: Shows a line about a journal that could not be converted.

        Raises:
            PuddleError: The folder is not writable, or the log's journal exists.
        """
        self.path = path
        self.entries: list[LogEntry] = []
        self._journal = path.with_name(path.name + JOURNAL)
        with disk.explained("writing the log", path, advice="run the same command again; nothing was moved"):
            path.parent.mkdir(parents=True, exist_ok=True)
            _convert_abandoned(path.parent, say)
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


_ENTRY = TypeAdapter(LogEntry)
_NAMES = {field.name for field in fields(LogEntry)}


def _entry(line: bytes) -> LogEntry:
    """Read a line of a journal. Raises ValueError if it is not an entry, with every field and no other."""
    entry = _ENTRY.validate_json(line)
    if set(json.loads(line)) != _NAMES:
        raise ValueError("a field is missing")
    return entry


def _convert_abandoned(folder: Path, say: Callable[[str], None]) -> None:
    """Convert the journals that no living process has locked. Whatever is wrong with one does not stop a run."""
    for journal in sorted(folder.glob(f"*{JOURNAL}")):
        try:
            if not _is_ours(journal):
                continue
            lock = disk.try_lock(journal)
            if lock is None:
                continue
            try:
                reason = _convert(journal)
                if reason is not None:
                    aside = disk.unused(journal.with_name(journal.name + _DAMAGED))
                    disk.rename(journal, aside)
                    say(f"{journal}: {reason}. It was not converted, and is now {aside.name}.")
            finally:
                os.close(lock)
        except (OSError, PuddleError) as error:
            say(f"{journal}: the journal of an earlier run could not be converted and was left as it is ({error}).")


def _is_ours(journal: Path) -> bool:
    """Return whether puddle wrote a file: it has the name of a journal, or begins with an entry."""
    try:
        first, end, _ = disk.read(journal, at_most=2**16).partition(b"\n")
        if _DEFAULT_JOURNAL.fullmatch(journal.name):
            return True
        return bool(end) and bool(_entry(first))
    except (OSError, ValueError):
        return False


def _convert(journal: Path) -> str | None:
    """Turn a locked journal into a log. Return why that is not possible, or None."""
    target = journal.with_name(journal.name.removesuffix(JOURNAL))
    lines = disk.read(journal, at_most=journal.stat().st_size).split(b"\n")[:-1]  # the last may be cut off
    entries = []
    for number, line in enumerate(lines, start=1):
        try:
            entries.append(_entry(line))
        except ValueError:
            return f"line {number} is not an entry of a servo log"
    try:
        data = _encode(entries)
    except (ValueError, OverflowError):
        return "an entry holds a number that is too large"
    if target.is_symlink() or (target.exists() and disk.read(target, at_most=len(data)) != data):
        return f"{target.name} exists and is another file"
    disk.place(target, data)
    disk.unlink(journal)
    return None
