"""The command line as a person uses it, in this process."""

import pytest

from pipeline.commands.app import main

WITHOUT_MLFLOW = ("--tracking-uri", "http://127.0.0.1:1")
"""Options for a study that finds no MLflow server, and so need not import MLflow: seconds of a core."""


def call(*arguments: str) -> int:
    """Run `puddle` with arguments; return its exit code."""
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    return int(ended.value.code or 0)


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run a command that refuses its arguments; return its message, all that it prints."""
    capsys.readouterr()
    assert call(*arguments) == 2
    said = capsys.readouterr()
    assert not said.out and "Traceback" not in said.err
    return said.err
