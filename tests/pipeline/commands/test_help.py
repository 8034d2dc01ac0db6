"""The help, the version and shell completion."""

import importlib.metadata

import pytest
import typer
from command_line import call
from typer.testing import CliRunner

from pipeline.commands.app import app
from pipeline.store.store import Store

COMMANDS = typer.main.get_command(app).commands


def help_of(capsys, *words: str) -> str:
    capsys.readouterr()
    assert call(*words) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_the_help_of_a_command_is_whole(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "72")
    said = help_of(capsys, name, "-h")
    assert max(map(len, said.splitlines())) <= 72
    for parameter in (one for one in getattr(COMMANDS[name], "params", ()) if not getattr(one, "hidden", False)):
        for option in parameter.opts:
            assert option in said


def test_short_options_and_the_version(capsys):
    assert help_of(capsys, "-h") == help_of(capsys, "--help")
    assert help_of(capsys, "--version") == f"puddle {importlib.metadata.version('puddle')}\n"


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("puddle stud", ["studies", "study"]),
        ("puddle status t", ["thin-slush", "tiny"]),
        ("puddle simulate d.json --study t", ["thin-slush", "tiny"]),
        ("puddle status --preset p", ["paper", "pontoon"]),
    ],
)
def test_the_shell_completes_commands_studies_and_presets(line, expected, tmp_path, monkeypatch):
    store = Store.open(tmp_path / "store", create=True)
    for name in ("tiny", "thin-slush", "other"):
        store.study_path(name).mkdir(parents=True)
        (store.study_path(name) / "study.json").touch()
    asked = {"_PUDDLE_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(line.split()) - 1)}
    ran = CliRunner().invoke(app, [], prog_name="puddle", env=asked | {"PUDDLE_STORE": str(store.root)})
    assert sorted(ran.stdout.split()) == expected
