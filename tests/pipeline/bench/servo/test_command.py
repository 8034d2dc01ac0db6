"""``puddle servo play`` against a simulated controller."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from command_line import call, refused
from typer.testing import CliRunner

from pipeline.bench.fabrication.kit_files import calibration_yaml, timeline_json
from pipeline.bench.servo.play import Connection, User, play_timeline
from pipeline.commands.app import app
from tasks.bench.fabrication.timeline import Timeline, envelope


@pytest.fixture
def kit(tmp_path, calibration) -> Path:
    """The files of a kit that a run needs, with 20 s of swinging."""
    seconds = np.arange(1001) / 50
    rise = envelope(seconds, duration=20.0, ramp=1.0)
    swing = Timeline(joints=(2, 4), angle=rise[:, None] * 0.6 * np.sin(np.pi * seconds[:, None] + [0.0, 1.0]))
    (tmp_path / "kit").mkdir()
    (tmp_path / "kit" / "timeline.json").write_bytes(timeline_json(swing, calibration))
    (tmp_path / "kit" / "calibration.yaml").write_bytes(calibration_yaml(calibration, "of a test"))
    return tmp_path / "kit"


def rows_of(log: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(log.open()))


def played(kit: Path, log: Path | None, clock, **options) -> tuple[bool, str]:
    """Play in this process, on a clock of the test. Returns whether the run ended, and what the user was shown."""
    lines: list[str] = []
    user = User(confirm=lambda question: True, say=lines.append)
    ended = play_timeline(kit, Connection(timeout=10.0, dry_run=True), user, log=log, clock=clock, **options)
    return ended, "\n".join(lines)


def test_a_dry_run(kit, tmp_path, clock, capsys, monkeypatch):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    faults = [{"severity": severity, "where": "", "message": ""} for severity in ("fault", "warning", "fault")]
    (kit / "kit.json").write_text(json.dumps({"findings": faults}))
    ended, said = played(kit, None, clock, duration=0.5)
    (log,) = kit.glob("servo-20??????-??????.csv")  # beside the timeline
    assert ended and not list((tmp_path / "elsewhere").iterdir())
    assert "joint 2 on channel 0: -34° to +34°" in said and "dry run" in said and f"The log of this run: {log}" in said
    assert "This kit has 2 faults" in said
    assert sum(row["frame"] != "" for row in rows_of(log)) == 2 * 25
    assert call("servo", "play", str(kit), "--dry-run", "--log", str(log)) == 2
    assert "File exists" in capsys.readouterr().err


def test_nothing_moves_without_consent(kit, tmp_path, plug):
    fake, log, runner = plug(), tmp_path / "never.csv", CliRunner()
    for answer in ("n\n", ""):
        result = runner.invoke(app, ["servo", "play", str(kit), "--port", fake.path, "--log", str(log)], input=answer)
        assert result.exit_code == 130 and "Nothing was moved" in result.output and "jump to neutral" in result.output
    fake.finish()
    assert fake.n_bytes == 0 and not log.exists()
    again = plug()
    arguments = ["servo", "play", str(kit), "--port", again.path, "--log", str(log), "--duration", "0.1"]
    result = runner.invoke(app, [*arguments, "--timeout", "10"], input="y\n")  # the thread may wait on a busy machine
    assert result.exit_code == 0 or "s late" in str(result.exception), result  # late on a busy machine
    again.finish()
    assert again.pulses(0)[0] == 1500.0 and again.pulses(0)[-1] == 0


def test_mistakes(kit, tmp_path, capsys):
    text = (kit / "calibration.yaml").read_text()

    def changed(old: str, new: str) -> tuple[str, ...]:
        (path := tmp_path / f"{len(list(tmp_path.iterdir()))}.yaml").write_text(text.replace(old, new, 1))
        return str(kit), "--calibration", str(path), "--dry-run"

    (tmp_path / "bare").mkdir()
    (tmp_path / "bare" / "kit.json").write_text("{}")
    for arguments, said in (
        ((), "{timeline}"),
        ((str(kit),), "--port"),
        ((str(kit), "--port", "/dev/ttyNOPE", "--yes"), "no such port"),
        ((str(kit / "none.json"), "--dry-run"), "can't read the timeline"),
        (changed("max_us: 2100", "max_us: 1700"), r"joint 2 \(channel 0\) at .*900 to 1700.*\. Nothing was moved"),
        (changed("max_us: 2100", "max_us: 800"), r"yaml: .*swapped"),
        ((str(kit), "--calibration", str(tmp_path / "gone.yaml"), "--dry-run"), "gone.yaml: expected a settings file"),
        ((str(tmp_path / "bare"), "--dry-run"), "can't play this gait"),
    ):
        assert re.search(said, refused(capsys, "servo", "play", *arguments), flags=re.S), said
    assert sorted(path.name for path in kit.iterdir()) == ["calibration.yaml", "timeline.json"]
