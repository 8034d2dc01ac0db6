"""The options that commands share: the command lines that messages advise mean what the person chose."""

from pathlib import Path

import pytest

from pipeline.commands.options import Chosen


@pytest.mark.parametrize(
    ("variable", "chosen", "expected"),
    [
        (None, "store", "puddle gc"),
        ("", "store", "puddle gc"),  # as typer takes it
        (None, "other", "puddle gc --store other"),
        ("other", "other", "puddle gc"),
        ("other", "store", "puddle gc --store store"),
        ("other", "third", "puddle gc --store third"),
    ],
)
def test_an_advised_command_is_for_the_same_store(variable, chosen, expected, monkeypatch):
    """It names the store unless the command would take that one by itself: the variable's, where there is one."""
    monkeypatch.delenv("PUDDLE_STORE", raising=False)
    if variable is not None:
        monkeypatch.setenv("PUDDLE_STORE", variable)
    assert Chosen("laptop", None, (), Path(chosen)).command("gc") == expected
