"""Command lines that messages advise carry the user's own options."""

from pathlib import Path

import pytest
from command_line import call

from pipeline.commands.options import StudyOptions
from pipeline.errors import PuddleError


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
    assert StudyOptions(store=Path(chosen)).command("gc") == expected


@pytest.mark.parametrize(
    ("chosen", "expected"),
    [
        ({"study": "mine"}, "puddle train --study mine"),
        ({"preset": "row"}, "puddle train --preset row"),
        ({"preset": "laptop"}, "puddle train"),
        (
            {"settings_file": Path("my file.yaml"), "overrides": ["seed=2"]},
            "puddle train --settings 'my file.yaml' --set seed=2",
        ),
    ],
)
def test_an_advised_command_has_the_same_settings(chosen, expected, monkeypatch):
    monkeypatch.delenv("PUDDLE_STORE", raising=False)
    assert StudyOptions(**chosen).command("train") == expected


@pytest.mark.parametrize(
    "chosen",
    [
        {"study": "mine", "preset": "row"},
        {"study": "mine", "settings_file": Path("mine.yaml")},
        {"preset": "laptop", "settings_file": Path("mine.yaml")},
    ],
)
def test_two_sources_of_settings_are_refused(chosen):
    with pytest.raises(PuddleError, match="expected only one of --study, --preset and --settings, got --"):
        StudyOptions(**chosen)


@pytest.mark.parametrize(
    "command",
    [
        ("studies",),
        ("status", "--preset", "smoke"),
        ("study", "--preset", "smoke", "--workers", "0"),
        ("doctor", "--preset", "smoke", "--workers", "0"),
        ("verify",),
        ("gc",),
        ("ui",),
        ("export", "tiny", "--out", "out"),
    ],
    ids=lambda command: command[0],
)
@pytest.mark.parametrize("place", ["circle", "circle/store", "~no-such-user/store", "too/" * 1500 + "store"])
def test_a_store_at_a_path_that_cannot_be_followed(command, place, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("circle").symlink_to("other")
    Path("other").symlink_to("circle")
    code = call(*command, "--store", place)
    said = capsys.readouterr()
    assert code in ((1,) if command[0] == "doctor" else (2,))
    assert place[-40:] in "".join((said.out + said.err).split("\n")) and "Traceback" not in said.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["circle", "other"]
