"""The help, the version and shell completion."""

import importlib.metadata

import pytest
import typer
from command_line import call

from pipeline.commands.app import app

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
