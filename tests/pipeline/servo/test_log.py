"""The servo log: a killed run's journal becomes a log, and no file of anyone else is touched."""

import dataclasses
import json
import math
import os
from pathlib import Path

import pytest

from pipeline.errors import PuddleError
from pipeline.servo.log import JOURNAL, LogEntry, ServoLog
from pipeline.store import disk
from pipeline.store.encoding import decode_table

PULSE = LogEntry(0.02, channel=0, wanted=1500.0, sent=1500.0)


def table_of(path: Path):
    return decode_table(path.read_bytes(), schema="servo_log", version=1, source="log")


def killed(path: Path, *entries: LogEntry, torn: bytes = b"") -> Path:
    """Write a log as a process that is then killed; return its journal."""
    log = ServoLog(path, print)
    log.add(*entries)
    os.write(log._descriptor, torn)
    os.close(log._lock)
    os.close(log._descriptor)
    return path.with_name(path.name + JOURNAL)


def next_run(folder: Path) -> list[str]:
    """Write and close another log in a folder; return what it says of the journals there."""
    said: list[str] = []
    ServoLog(folder / "next.parquet", said.append).close()
    (folder / "next.parquet").unlink()
    return said


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_the_journal_of_a_killed_run_is_converted(tmp_path):
    journal = killed(tmp_path / "killed.parquet", LogEntry(0.0, event="start"), PULSE, torn=b'{"time": 0.04, "eve')
    assert next_run(tmp_path) == []
    table = table_of(tmp_path / "killed.parquet")
    assert table["event"].tolist() == ["start", ""] and table["sent"][1] == 1500.0 and math.isnan(table["sent"][0])
    assert not journal.exists()


def test_the_journal_of_a_living_run_is_left_alone(tmp_path):
    living = ServoLog(tmp_path / "living.parquet", print)
    living.add(PULSE)
    assert next_run(tmp_path) == [] and not living.path.exists()
    living.close()
    assert table_of(living.path)["sent"].tolist() == [1500.0]


def test_a_run_killed_between_its_log_and_its_journals_removal(tmp_path):
    journal = killed(tmp_path / "killed.parquet", PULSE)
    kept = journal.read_bytes()
    next_run(tmp_path)
    log = (tmp_path / "killed.parquet").read_bytes()
    journal.write_bytes(kept)
    assert next_run(tmp_path) == []
    assert contents(tmp_path) == {"killed.parquet": log}


@pytest.mark.parametrize(
    "journal",
    [b"x\n", b"", b'{"time": 1.0}\n', b'{"time": "now", "event": ""}\n', b"[]\n", b"\xff\xfe\n", b"{\n" * 1000],
)
def test_files_of_others_are_not_touched(tmp_path, journal):
    (tmp_path / "data.csv").write_bytes(b"precious\n")
    (tmp_path / "data.csv.journal").write_bytes(journal)
    (tmp_path / "elsewhere.journal").symlink_to(tmp_path / "data.csv.journal")
    os.mkfifo(tmp_path / "pipe.journal")
    (tmp_path / "folder.journal").mkdir()
    names = {path.name for path in tmp_path.iterdir()}
    assert next_run(tmp_path) == []
    assert {path.name for path in tmp_path.iterdir()} == names
    assert (tmp_path / "data.csv").read_bytes() == b"precious\n"
    assert (tmp_path / "data.csv.journal").read_bytes() == journal


def test_no_file_is_replaced_by_a_journals_log(tmp_path):
    journal = killed(tmp_path / "run.parquet", PULSE)
    kept = journal.read_bytes()
    (tmp_path / "run.parquet").write_bytes(b"precious")
    (said,) = next_run(tmp_path)
    assert (
        said.startswith(f"{journal}: run.parquet exists and is another file.")
        and "run.parquet.journal-1.damaged" in said
    )
    assert contents(tmp_path) == {"run.parquet": b"precious", "run.parquet.journal-1.damaged": kept}
    assert next_run(tmp_path) == []


LINE = json.dumps(PULSE.__dict__).encode()


@pytest.mark.parametrize(
    "body",
    [
        LINE + b"\nrubbish\n" + LINE + b"\n",
        LINE.replace(b"0.02", b"1e999") + b"\n",
        LINE.replace(b"0.02", b"NaN") + b"\n",
        LINE.replace(b"-1", b"1" + b"0" * 400) + b"\n",
        LINE.replace(b"0.02", b'0.02, "more": 1') + b"\n",
        b"\x00" * 500 + b"\n",
    ],
)
def test_a_damaged_journal_is_put_aside_and_later_runs_go_on(tmp_path, body):
    journal = tmp_path / "servo-20260102-030405.parquet.journal"
    for number in (1, 2, 3):
        journal.write_bytes(body)
        (said,) = next_run(tmp_path)
        assert str(journal) in said and said.endswith(f"now {journal.name}-{number}.damaged.")
        assert not journal.exists()
    assert {path.read_bytes() for path in tmp_path.iterdir()} == {body} and len(list(tmp_path.iterdir())) == 3


def test_a_journal_of_any_length_is_converted(tmp_path, monkeypatch):
    monkeypatch.setitem(disk.read.__kwdefaults__, "at_most", 1000)  # instead of 64 MiB
    killed(tmp_path / "long.parquet", *(LogEntry(frame / 50, frame=frame) for frame in range(100)))
    next_run(tmp_path)
    assert table_of(tmp_path / "long.parquet")["frame"].tolist() == list(range(100))


def test_a_log_that_cannot_be_written_is_refused_before_anything_moves(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(PuddleError, match="writing the log"):
        ServoLog(tmp_path / "file" / "run.parquet", print)


def test_json_of_the_journal_has_every_field():
    assert set(json.loads(LINE)) == {field.name for field in dataclasses.fields(LogEntry)}
