"""``puddle servo`` against a simulated controller: in this process, and in one of its own in real time."""

import errno
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
from pipeline.errors import PuddleError
from pipeline.fabrication.timeline_file import calibration_yaml, timeline_json
from pipeline.servo.log import JOURNAL, ServoLog
from pipeline.servo.play import PlayOptions, play_timeline
from pipeline.store import disk
from pipeline.store.encoding import decode_table
from tasks.fabrication.timeline import Playback, Timeline, envelope

ROOT = Path(__file__).parents[3]


@pytest.fixture
def kit(tmp_path, calibration) -> Path:
    """The files of a kit that a run needs, with 20 s of swinging."""
    playback, seconds = Playback(duration=20.0, ramp=1.0), np.arange(1001) / 50
    rise = envelope(seconds, duration=playback.duration, ramp=playback.ramp)
    swing = Timeline(joints=(2, 4), angle=rise[:, None] * 0.6 * np.sin(np.pi * seconds[:, None] + [0.0, 1.0]))
    (tmp_path / "kit").mkdir()
    (tmp_path / "kit" / "timeline.json").write_bytes(timeline_json(swing, calibration))
    (tmp_path / "kit" / "calibration.yaml").write_bytes(calibration_yaml(calibration, "of a test"))
    return tmp_path / "kit"


def table_of(path: Path):
    return decode_table(path.read_bytes(), schema="servo_log", version=1, source=str(path))


def played(kit: Path, log: Path | None, clock, **options) -> tuple[bool, str]:
    """Play in this process, on a clock of the test. Returns whether the run ended, and what the user was shown."""
    lines: list[str] = []
    chosen = PlayOptions(kit, log=log, timeout=10.0, **options)
    try:
        return play_timeline(chosen, confirm=lambda question: True, say=lines.append, clock=clock), "\n".join(lines)
    except Exception as error:
        error.add_note("\n".join(lines))
        raise


def test_a_dry_run(kit, tmp_path, clock, capsys):
    log = tmp_path / "dry.parquet"
    ended, said = played(kit, log, clock, dry_run=True, duration=0.5)
    assert ended
    assert "joint 2 on channel 0: -34° to +34°" in said and "dry run" in said and "End" not in said
    table = table_of(log)
    assert (table["frame"] >= 0).sum() == 2 * 25
    assert call("servo", "play", str(kit), "--dry-run", "--log", str(log)) == 2
    assert "already exists" in capsys.readouterr().err


def test_the_log_goes_beside_the_timeline(kit, tmp_path, clock, monkeypatch):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    _, said = played(kit, None, clock, dry_run=True, duration=0.1)
    (log,) = kit.glob("servo-20??????-??????.parquet")
    assert f"The log of this run: {log}" in said
    assert "start" in table_of(log)["event"]
    assert not list((tmp_path / "elsewhere").iterdir())


def test_faults_of_a_kit_are_shown_before_it_moves(kit, clock):
    for found, said in (
        (["fault", "warning", "fault"], "This kit has 2 faults"),
        (["fault"], "This kit has 1 fault."),
        (["note"], None),
    ):
        mark = {"findings": [{"severity": severity, "where": "joint 2", "message": "x"} for severity in found]}
        (kit / "kit.json").write_text(json.dumps(mark))
        log = kit / f"{len(found)}{found[0]}.parquet"
        _, out = played(kit, log, clock, dry_run=True, duration=0.1)
        assert said in out if said else "This kit has" not in out


def test_changed_files_of_a_kit_are_reported_before_it_moves(kit, tmp_path, clock):
    """Users edit calibrations, but a damaged digit would move a servo too."""

    def said(calibration: Path | None = None) -> list[str]:
        log = tmp_path / f"{len(list(tmp_path.iterdir()))}.parquet"
        _, lines = played(kit, log, clock, dry_run=True, duration=0.1, calibration=calibration)
        return [line for line in lines.splitlines() if "since the kit was made" in line]

    assert said() == []  # not a kit: nothing to compare with
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
        assert line.startswith(f"{kit / name} has changed") and "did not edit it" in line
        if name == "calibration.yaml":
            assert said(tmp_path / name) == []  # a file that the user chose
        (kit / name).write_bytes(files[name])
    for odd in ([], {"files": []}, {"files": {"calibration.yaml": 3}}, {"findings": 3}, {"findings": {"severity": 1}}):
        (kit / "kit.json").write_text(json.dumps(odd))
        said()


def test_nothing_moves_without_consent(kit, tmp_path, plug):
    fake = plug()
    runner = CliRunner()
    log = tmp_path / "never.parquet"
    for answer in ("n\n", ""):
        result = runner.invoke(app, ["servo", "play", str(kit), "--port", fake.path, "--log", str(log)], input=answer)
        assert result.exit_code == 130 and "Nothing was moved" in result.output and "jump to neutral" in result.output
    fake.finish()
    assert fake.n_bytes == 0 and not log.exists()
    result = runner.invoke(
        app,
        ["servo", "play", str(kit), "--port", (again := plug()).path, "--log", str(log), "--duration", "0.1", *PATIENT],
        input="y\n",
    )
    assert result.exit_code == 0 or "s late" in str(result.exception), result  # late on a busy machine
    again.finish()
    assert again.pulses(0)[0] == 1500.0 and again.pulses(0)[-1] == 0


@pytest.mark.parametrize("loop", [(), ("--loop",)])
@pytest.mark.parametrize("duration", ["0", "-1", "nan", "inf"])
def test_a_duration_that_is_none_is_refused_before_anything_moves(kit, tmp_path, plug, capsys, duration, loop):
    fake, log = plug(), tmp_path / "never.parquet"
    options = ("--port", fake.path, "--yes", "--log", str(log), f"--duration={duration}")
    assert call("servo", "play", str(kit), *options, *loop) == 2
    said = capsys.readouterr()
    assert said.out == "" and f"--duration: expected more than 0 s, got {duration}" in said.err
    fake.finish()
    assert fake.n_bytes == 0 and not log.exists()


def test_mistakes(kit, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def refused(*arguments: str) -> str:
        assert call("servo", "play", *arguments) == 2
        return capsys.readouterr().err

    assert "--list-ports" in refused()
    assert "--port" in refused(str(kit))
    assert "no such port" in refused(str(kit), "--port", "/dev/ttyNOPE", "--yes")
    assert "can't read the timeline" in refused(str(kit / "none.json"), "--dry-run")
    narrow = (kit / "calibration.yaml").read_text().replace("max_us: 2100", "max_us: 1700")
    (tmp_path / "narrow.yaml").write_text(narrow)
    said = refused(str(kit), "--calibration", str(tmp_path / "narrow.yaml"), "--dry-run")
    assert "joint 2 (channel 0) at" in said and "900 to 1700" in said and ". Nothing was moved" in said
    assert ".. Nothing" not in said
    truth = (kit / "calibration.yaml").read_text().replace("direction: 1 ", "direction: true ", 1)
    (tmp_path / "narrow.yaml").write_text(truth)
    said = refused(str(kit), "--calibration", str(tmp_path / "narrow.yaml"), "--dry-run")
    assert "expected 1 or -1, got true" in said
    (tmp_path / "narrow.yaml").write_text((kit / "calibration.yaml").read_text().replace("joint: ", "joint: 4"))
    said = refused(str(kit), "--calibration", str(tmp_path / "narrow.yaml"), "--dry-run")
    assert said.count("joint: expected a number less than 6") == 2 and len(said.splitlines()) == 2
    for gone in (tmp_path / "gone.yaml", tmp_path):
        said = refused(str(kit), "--calibration", str(gone), "--dry-run")
        assert f"{gone}: can't read the calibration file" in said and "settings" not in said
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
    assert call("servo", "play", "--list-ports") == 0
    assert "port" in capsys.readouterr().out.lower()


PATIENT = ("--timeout", "10")
"""Time for the simulated controller's thread to answer on a busy machine."""

PLAY = """
import sys, time
from pathlib import Path
from pipeline.servo.play import PlayOptions, play_timeline

class UnhurriedClock:
    time = 0.0
    def now(self):
        return self.time
    def sleep(self, duration):
        time.sleep(duration)
        self.time += duration

kit, port, log = sys.argv[1:]
options = PlayOptions(Path(kit), port=port, log=Path(log), timeout=10.0)
sys.exit(0 if play_timeline(options, confirm=lambda question: True, say=print, clock=UnhurriedClock()) else 130)
"""
"""A run in a process of its own that waits in real time but is never late, however busy the machine is."""


def started(kit: Path, fake, log: Path) -> subprocess.Popen:
    """Start a run in its own process and wait until it plays the timeline."""
    command = [sys.executable, "-c", PLAY, str(kit), fake.path, str(log)]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    patience = time.monotonic() + 60
    while len(fake.pulses(0)) < 70:
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < patience
        time.sleep(0.01)
    return process


def test_a_second_ctrl_c_is_not_reported_as_neutral(kit, tmp_path, plug, clock):
    fake, log = plug(), tmp_path / "run.parquet"

    class Interrupting(type(clock)):
        def sleep(self, duration: float) -> None:
            super().sleep(duration)
            if self.time > 102.5:  # once during the run and again during the return
                os.kill(os.getpid(), signal.SIGINT)

    ended, said = played(kit, log, Interrupting(), port=fake.path)
    assert not ended
    fake.finish()
    assert not fake.on and abs(fake.pulses(0)[-2] - 1500.0) > 100
    for words in (said, "\n".join(table_of(log)["event"])):
        assert "switched off away from neutral, last sent to: joint 2 (channel 0) " in words
        assert "switched off at neutral" not in words


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_a_signal(kit, tmp_path, plug, kind):
    fake, log = plug(), tmp_path / "run.parquet"
    process = started(kit, fake, log)
    process.send_signal(kind)
    _, said = process.communicate(timeout=120)
    fake.finish()
    assert process.returncode == 130, said
    assert not fake.on and fake.pulses(0)[-2:] == [1500.0, 0.0] and fake.pulses(3)[-2:] == [1480.5, 0.0]
    assert "stopped by the user" in table_of(log)["event"]


def test_killed(kit, tmp_path, plug, clock):
    """After SIGKILL the controller's own time-out switches the servos off, and the journal remains."""
    fake, log = plug(timeout=0.5), tmp_path / "run.parquet"
    process = started(kit, fake, log)
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stderr.close()
    patience = time.monotonic() + 60
    while fake.on:
        assert time.monotonic() < patience
        time.sleep(0.02)
    fake.finish()
    assert Path(f"{log}{JOURNAL}").exists() and not log.exists()
    # The next run converts the journal up to the last pulse, which is recorded before it is sent.
    played(kit, tmp_path / "next.parquet", clock, dry_run=True, duration=0.1)
    table = table_of(log)
    sent = table["sent"][(table["channel"] == 0) & np.isfinite(table["sent"])].tolist()
    received = fake.pulses(0)
    assert len(received) - len(sent) in (0, 1) and sent == received[: len(sent)]


def test_unplugged_during_the_run(kit, tmp_path, plug, clock):
    fake, log = plug(unplug_after=1200), tmp_path / "run.parquet"
    with pytest.raises(PuddleError) as raised:
        played(kit, log, clock, port=fake.path)
    said = str(raised.value)
    assert "lost the port" in said and "NOT SWITCHED OFF" in said and str(log) in said
    received = fake.pulses(3)
    table = table_of(log)
    sent = table["sent"][(table["channel"] == 3) & np.isfinite(table["sent"])].tolist()
    assert sent[: len(received)] == received


class DefectiveClock:
    """Wraps a clock and raises once, as a defect in the playing loop would."""

    def __init__(self, clock, *, at: float) -> None:
        self._clock, self._at = clock, at
        self.now = clock.now

    def sleep(self, duration: float) -> None:
        self._clock.sleep(duration)
        if self._clock.now() > self._at:
            self._at = float("inf")
            raise ZeroDivisionError


@pytest.mark.parametrize("ends", ["by itself", "with its port", "by a defect"])
def test_the_servos_state_is_reported_if_the_log_cannot_be_written(kit, tmp_path, plug, clock, monkeypatch, ends):
    fake, log, place = plug(unplug_after=600 if ends == "with its port" else None), tmp_path / "run.parquet", disk.place

    def full(path: Path, data: bytes) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(disk, "place", full)
    with pytest.raises(PuddleError, match="writing the log failed") as raised:
        clock = DefectiveClock(clock, at=101.5) if ends == "by a defect" else clock
        played(kit, log, clock, port=fake.path, duration=1.0)
    (said,) = raised.value.__notes__
    assert f"Servos: {'NOT SWITCHED OFF' if ends == 'with its port' else 'switched off at neutral'}" in said
    assert str(log) in str(raised.value) and f"{log}{JOURNAL}" in str(raised.value)
    assert "goes on from there" not in str(raised.value)  # a run is not resumed
    monkeypatch.setattr(disk, "place", place)
    ServoLog(tmp_path / "next.parquet", print).close()  # follows the advice in the message
    assert any("servos: " in event for event in table_of(log)["event"]) and not Path(f"{log}{JOURNAL}").exists()


def test_a_defect_does_not_hide_the_state_of_the_servos(kit, tmp_path, plug, clock):
    with pytest.raises(ZeroDivisionError) as raised:
        played(kit, tmp_path / "run.parquet", DefectiveClock(clock, at=101.5), port=plug().path)
    assert "Servos: switched off at neutral" in raised.value.__notes__[0]
