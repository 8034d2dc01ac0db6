"""The help, the version and shell completion."""

import importlib.metadata

from command_line import call


def help_of(capsys, *words: str) -> str:
    capsys.readouterr()
    assert call(*words) == 0
    return capsys.readouterr().out


def test_short_options_and_the_version(capsys):
    assert help_of(capsys, "-h") == help_of(capsys, "--help")
    assert help_of(capsys, "--version") == f"puddle {importlib.metadata.version('puddle')}\n"
