"""``puddle drive`` as a person uses it: in a process of its own, in real time, against a pty."""

import errno
import functools
import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from command_line import call
from typer.testing import CliRunner

from pipeline.commands.app import app
from pipeline.fabrication.timeline_file import calibration_yaml, timeline_json
from pipeline.servo import play
from pipeline.servo.log import JOURNAL, DriveLog, Entry
from pipeline.servo.player import Player, RealClock
from pipeline.store import disk
from pipeline.store.encoding import decode_table
from tasks.fabrication.timeline import Playback, Timeline, envelope

ROOT = Path(__file__).parents[3]


@pytest.fixture
def kit(tmp_path, calibration) -> Path:
    """A folder with what a drive needs of a kit: 20 s of swinging."""
    playback, seconds = Playback(duration=20.0, ramp=1.0), np.arange(1001) / 50
    rise = envelope(seconds, duration=playback.duration, ramp=playback.ramp)
    swing = Timeline(joints=(2, 4), angle=rise[:, None] * 0.6 * np.sin(np.pi * seconds[:, None] + [0.0, 1.0]))
    (tmp_path / "kit").mkdir()
    (tmp_path / "kit" / "timeline.json").write_bytes(timeline_json(swing, calibration))
    (tmp_path / "kit" / "calibration.yaml").write_bytes(calibration_yaml(calibration, "of a test"))
    return tmp_path / "kit"


def table_of(path: Path):
    return decode_table(path.read_bytes(), schema="drive_log", version=1, source=str(path))


def test_a_dry_run(kit, tmp_path, capsys):
    log = tmp_path / "dry.parquet"
    assert call("drive", str(kit), "--dry-run", "--duration", "0.5", "--log", str(log)) == 0
    said = capsys.readouterr().out
    assert "joint 2 on channel 0: -34° to +34°" in said and "dry run" in said and "End" not in said
    table = table_of(log)
    assert (table["frame"] >= 0).sum() == 2 * 25
    assert call("drive", str(kit), "--dry-run", "--log", str(log)) == 2
    assert "there already" in capsys.readouterr().err


def test_the_log_goes_beside_the_timeline(kit, tmp_path, capsys, monkeypatch):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert call("drive", str(kit), "--dry-run", "--duration", "0.1") in (0, 2)  # 2: this computer was late
    (log,) = kit.glob("drive-20??????-??????.parquet")
    assert f"What is sent will be in {log}" in capsys.readouterr().out
    assert "start" in table_of(log)["event"]
    assert not list((tmp_path / "elsewhere").iterdir())


def test_the_faults_of_a_kit_are_told_before_it_moves(kit, capsys):
    for found, said in (
        (["fault", "warning", "fault"], "2 faults found in this kit speak against it"),
        (["fault"], "1 fault found in this kit speaks against it"),
        (["note"], None),
    ):
        mark = {"findings": [{"severity": severity, "where": "joint 2", "message": "x"} for severity in found]}
        (kit / "kit.json").write_text(json.dumps(mark))
        call("drive", str(kit), "--dry-run", "--duration", "0.1", "--log", str(kit / f"{len(found)}{found[0]}.parquet"))
        out = capsys.readouterr().out
        assert said in out if said else "speak" not in out


def test_a_file_of_a_kit_that_was_edited_is_told_before_it_moves(kit, tmp_path, capsys):
    """A calibration is there to be edited, and one digit of it moves a servo: who changed nothing has to hear of it."""

    def said(*options: str) -> list[str]:
        log = tmp_path / f"{len(list(tmp_path.iterdir()))}.parquet"
        assert call("drive", str(kit), "--dry-run", "--duration", "0.1", "--log", str(log), *options) in (0, 2)
        return [line for line in capsys.readouterr().out.splitlines() if "was made with the kit" in line]

    assert said() == []  # it is no kit: nothing is known of its files
    files = {path.name: path.read_bytes() for path in kit.iterdir()}
    digests = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    (kit / "kit.json").write_text(json.dumps({"files": digests}))
    assert said() == []
    calibration, timeline = files["calibration.yaml"], files["timeline.json"]
    for name, changed in (
        ("calibration.yaml", calibration.replace(b"1500", b"1510", 1)),
        ("timeline.json", timeline + b"\n"),
    ):
        assert changed != files[name]
        (tmp_path / name).write_bytes(files[name])
        (kit / name).write_bytes(changed)
        (line,) = said()
        assert line.startswith(f"{kit / name} is not as it was made with the kit") and "changed nothing" in line
        if name == "calibration.yaml":
            assert said("--calibration", str(tmp_path / name)) == []  # another one, which the user chose
        (kit / name).write_bytes(files[name])
    for odd in ([], {"files": []}, {"files": {"calibration.yaml": 3}}):
        (kit / "kit.json").write_text(json.dumps(odd))
        said()


def test_nothing_moves_without_a_yes(kit, tmp_path, plug):
    fake = plug()
    runner = CliRunner()
    log = tmp_path / "never.parquet"
    for answer in ("n\n", ""):
        result = runner.invoke(app, ["drive", str(kit), "--port", fake.path, "--log", str(log)], input=answer)
        assert result.exit_code == 130 and "Nothing was moved" in result.output and "jump to neutral" in result.output
    fake.finish()
    assert fake.n_bytes == 0 and not log.exists()
    result = runner.invoke(
        app, ["drive", str(kit), "--port", (again := plug()).path, "--log", str(log), "--duration", "0.1"], input="y\n"
    )
    assert result.exit_code == 0, result.output
    again.finish()
    assert again.pulses(0)[-1] == 0 and len(again.pulses(0)) > 50


@pytest.mark.parametrize("loop", [(), ("--loop",)])
def test_a_duration_of_nothing_is_refused_before_anything_moves(kit, tmp_path, plug, capsys, loop):
    fake, log = plug(), tmp_path / "never.parquet"
    options = ("--port", fake.path, "--yes", "--log", str(log), "--duration", "0")
    assert call("drive", str(kit), *options, *loop) == 2
    said = capsys.readouterr()
    assert said.out == "" and "--duration: expected more than 0 s, came 0" in said.err
    fake.finish()
    assert fake.n_bytes == 0 and not log.exists()


def test_mistakes(kit, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def refused(*arguments: str) -> str:
        assert call("drive", *arguments) == 2
        return capsys.readouterr().err

    assert "--list-ports" in refused()
    assert "--port" in refused(str(kit))
    assert "no such port" in refused(str(kit), "--port", "/dev/ttyNOPE", "--yes")
    assert "can't be read" in refused(str(kit / "none.json"), "--dry-run")
    narrow = (kit / "calibration.yaml").read_text().replace("max_us: 2100", "max_us: 1700")
    (tmp_path / "narrow.yaml").write_text(narrow)
    said = refused(str(kit), "--calibration", str(tmp_path / "narrow.yaml"), "--dry-run")
    assert "joint 2 (channel 0) at" in said and "900 to 1700" in said and ". Nothing was moved" in said
    assert ".. Nothing" not in said
    truth = (kit / "calibration.yaml").read_text().replace("direction: 1 ", "direction: true ", 1)
    (tmp_path / "narrow.yaml").write_text(truth)
    said = refused(str(kit), "--calibration", str(tmp_path / "narrow.yaml"), "--dry-run")
    assert "expected 1 or -1, came true" in said
    (tmp_path / "narrow.yaml").write_text((kit / "calibration.yaml").read_text().replace("joint: ", "joint: 4"))
    said = refused(str(kit), "--calibration", str(tmp_path / "narrow.yaml"), "--dry-run")
    assert said.count("joint: expected a number less than 6") == 2 and len(said.splitlines()) == 2
    for gone in (tmp_path / "gone.yaml", tmp_path):
        said = refused(str(kit), "--calibration", str(gone), "--dry-run")
        assert f"{gone}: expected a calibration file" in said and "settings" not in said
    (tmp_path / "bare").mkdir()
    (tmp_path / "bare" / "kit.json").write_text("{}")
    said = refused(str(tmp_path / "bare"), "--dry-run")
    assert "can't play this gait" in said and str(tmp_path / "bare" / "kit.json") in said
    swapped = (kit / "calibration.yaml").read_text().replace("max_us: 2100", "max_us: 800")
    (kit / "calibration.yaml").write_text(swapped)
    said = refused(str(kit), "--dry-run")
    assert "swapped" in said and f"{kit / 'calibration.yaml'}:3" in said
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bare", "kit", "narrow.yaml"]


def test_ports_are_listed(capsys):
    assert call("drive", "--list-ports") == 0
    assert "port" in capsys.readouterr().out.lower()


PATIENT = """
from pipeline.commands.app import main
from pipeline.servo import maestro
maestro.PATIENCE = 10.0
main()
"""
"""`puddle` with patience for a controller that is a thread of a process, on a machine that has much else to do."""


def started(kit: Path, fake, log: Path, *options: str) -> subprocess.Popen:
    """A drive in a process of its own that has come well into its timeline."""
    command = [sys.executable, "-c", PATIENT, "drive", str(kit), "--port", fake.path, "--log", str(log), "--yes"]
    process = subprocess.Popen([*command, *options], cwd=ROOT, stderr=subprocess.PIPE, text=True)
    patience = time.monotonic() + 60
    while len(fake.pulses(0)) < 70:
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < patience
        time.sleep(0.01)
    return process


def test_a_second_ctrl_c_is_not_said_to_leave_them_at_neutral(kit, tmp_path, plug, capsys, monkeypatch):
    fake, log, time_now = plug(), tmp_path / "run.parquet", 0.0

    def sleep(self, duration: float) -> None:
        nonlocal time_now
        time_now += duration
        if time_now > 2.5:  # in the run, and again on the way home
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(RealClock, "now", lambda self: time_now)
    monkeypatch.setattr(RealClock, "sleep", sleep)
    assert call("drive", str(kit), "--port", fake.path, "--log", str(log), "--yes") == 130
    fake.finish()
    assert not fake.on and abs(fake.pulses(0)[-2] - 1500.0) > 100
    said, noted = capsys.readouterr().out, "\n".join(table_of(log)["event"])
    for words in (said, noted):
        assert "switched off where they stood, not at neutral: last sent were joint 2 (channel 0) to " in words
        assert "switched off at neutral" not in words


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_a_signal(kit, tmp_path, plug, kind):
    fake, log = plug(), tmp_path / "run.parquet"
    process = started(kit, fake, log)
    process.send_signal(kind)
    _, said = process.communicate(timeout=30)
    fake.finish()
    assert process.returncode == 130, said
    assert not fake.on and fake.pulses(0)[-2:] == [1500.0, 0.0] and fake.pulses(3)[-2:] == [1480.5, 0.0]
    assert "stopped by the user" in table_of(log)["event"]


def test_killed(kit, tmp_path, plug):
    """Nothing of ours runs any more: the controller's own time-out switches off, and the journal is there."""
    fake, log = plug(timeout=0.5), tmp_path / "run.parquet"
    process = started(kit, fake, log)
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stderr.close()
    patience = time.monotonic() + 10
    while fake.on:
        assert time.monotonic() < patience
        time.sleep(0.02)
    fake.finish()
    assert Path(f"{log}{JOURNAL}").exists() and not log.exists()
    # The next drive into the same folder makes a log of it, down to what was sent last; the bytes come after the note.
    next_log = str(tmp_path / "next.parquet")
    assert call("drive", str(kit), "--dry-run", "--duration", "0.1", "--log", next_log) in (0, 2)  # 2: it was late
    table = table_of(log)
    sent = table["sent"][(table["channel"] == 0) & np.isfinite(table["sent"])].tolist()
    received = fake.pulses(0)
    assert len(received) - len(sent) in (0, 1) and sent == received[: len(sent)]


def test_all_of_a_killed_drives_journal_is_kept_however_long_it_is(tmp_path, monkeypatch):
    log = DriveLog(tmp_path / "long.parquet")
    log.add(*(Entry(frame / 50, frame=frame) for frame in range(100)))
    os.close(log._lock)  # killed
    monkeypatch.setitem(disk.read.__kwdefaults__, "at_most", 1000)  # of a document, in place of 64 MiB
    DriveLog(tmp_path / "next.parquet").close()
    assert table_of(log.path)["frame"].tolist() == list(range(100))


def test_unplugged_half_way(kit, tmp_path, plug, capsys):
    fake, log = plug(unplug_after=1200), tmp_path / "run.parquet"
    assert call("drive", str(kit), "--port", fake.path, "--log", str(log), "--yes") == 2
    said = capsys.readouterr().err
    assert "the port is lost" in said and "COULD NOT BE SWITCHED OFF" in said and str(log) in said
    received = fake.pulses(3)
    table = table_of(log)
    sent = table["sent"][(table["channel"] == 3) & np.isfinite(table["sent"])].tolist()
    assert sent[: len(received)] == received


@pytest.mark.parametrize("ends", ["by itself", "with its port", "by a defect"])
def test_how_the_servos_were_left_is_said_where_the_log_can_not_be_written(
    kit, tmp_path, plug, clock, capsys, monkeypatch, ends
):
    fake, log, place = plug(unplug_after=600 if ends == "with its port" else None), tmp_path / "run.parquet", disk.place

    def full(path: Path, data: bytes) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(play, "Player", functools.partial(Player, clock=clock))
    monkeypatch.setattr(disk, "place", full)
    if ends == "by a defect":
        monkeypatch.setattr(Player, "_follow", lambda *_: 1 / 0)
    options = ("--port", fake.path, "--yes", "--log", str(log), "--duration", "1")
    assert call("drive", str(kit), *options) == 2
    said = capsys.readouterr()
    left = "THEY COULD NOT BE SWITCHED OFF" if ends == "with its port" else "they were switched off at neutral"
    assert f"The servos: {left}" in said.out
    assert f"{log}: writing the log failed" in said.err and f"{log}{JOURNAL}" in said.err
    assert "goes on from there" not in said.err  # a drive does not
    monkeypatch.setattr(disk, "place", place)
    DriveLog(tmp_path / "next.parquet").close()  # as it said
    assert any("the servos: " in event for event in table_of(log)["event"]) and not Path(f"{log}{JOURNAL}").exists()


def test_a_defect_does_not_hide_how_the_servos_were_left(kit, tmp_path, plug, clock, capsys, monkeypatch):
    fake = plug()
    monkeypatch.setattr(play, "Player", functools.partial(Player, clock=clock))
    monkeypatch.setattr(Player, "_follow", lambda *_: 1 / 0)
    assert call("drive", str(kit), "--port", fake.path, "--yes", "--log", str(tmp_path / "run.parquet")) == 70
    said = capsys.readouterr()
    assert "The servos: they were switched off at neutral" in said.out and "ZeroDivisionError" in said.err
