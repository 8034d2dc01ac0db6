"""Command lines that messages advise carry the user's own options."""

from pathlib import Path

import pytest

from pipeline.commands.options import StudyOptions


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
    """The store is named unless it is the default, which the environment variable may set."""
    monkeypatch.delenv("PUDDLE_STORE", raising=False)
    if variable is not None:
        monkeypatch.setenv("PUDDLE_STORE", variable)
    assert StudyOptions("laptop", None, None, Path(chosen)).command("gc") == expected
