"""The help, the version and shell completion."""

import importlib.metadata
import re

import pytest
import typer
from command_line import call
from typer.testing import CliRunner

from pipeline.commands.app import app
from pipeline.store.store import Store

COMMANDS = typer.main.get_command(app).commands
SHOWN = {name: command for name, command in COMMANDS.items() if not command.hidden}


def help_of(capsys, *words: str) -> str:
    capsys.readouterr()
    assert call(*words) == 0
    return capsys.readouterr().out


def plain(text: str) -> str:
    """Return the words of a help text, without boxes, Markdown and line breaks."""
    return " ".join(re.sub(r"[│╭╮╰╯─`*]", " ", text).split())


@pytest.mark.parametrize("width", [80, 120])
def test_commands_are_in_panels_and_no_line_is_clipped(width, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(width))
    said = help_of(capsys, "--help")
    assert re.findall(r"╭─ (\w+) ─", said) == ["Options", "Daily", "Build", "Care", "Stages"]
    assert {command.rich_help_panel for command in SHOWN.values()} == {"Daily", "Build", "Care", "Stages"}
    assert "…" not in said and "..." not in said.replace("[ARGS]...", "")
    assert max(map(len, said.splitlines())) <= width and len(said.splitlines()) <= 50
    for name, command in SHOWN.items():
        assert re.search(rf"^│ {name} ", said, flags=re.M)
        assert command.help, name
        assert plain(command.help.split("\n\n")[0]) in plain(said)


@pytest.mark.parametrize("width", [72, 80])
@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_the_help_of_a_command_is_whole(name, width, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(width))
    said = help_of(capsys, name, "-h")
    assert max(map(len, said.splitlines())) <= width
    for parameter in (one for one in getattr(COMMANDS[name], "params", ()) if not getattr(one, "hidden", False)):
        for option in parameter.opts:
            assert option in said
        for word in (parameter.help or "").split():
            assert re.sub(r"[`*]", "", word)[:12] in said, (parameter.name, word)  # a long word may be broken


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
