"""Command lines that messages advise carry the user's own options, and run from where the user stands."""

import sysconfig
from pathlib import Path

import pytest
from command_line import call

from pipeline.commands import options
from pipeline.commands.options import StudyOptions, program
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
    monkeypatch.setattr(options, "program", lambda: "puddle")
    assert StudyOptions(store=Path(chosen)).command("gc") == expected


@pytest.mark.parametrize(
    ("chosen", "expected"),
    [
        ({"study": "mine"}, "puddle train mine"),
        ({"name": "mine"}, "puddle train mine"),
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
    monkeypatch.setattr(options, "program", lambda: "puddle")
    assert StudyOptions(**chosen).command("train") == expected


@pytest.mark.parametrize(
    "chosen",
    [
        {"study": "mine", "preset": "row"},
        {"study": "mine", "settings_file": Path("mine.yaml")},
        {"preset": "laptop", "settings_file": Path("mine.yaml")},
        {"name": "mine", "preset": "row"},
    ],
)
def test_two_sources_of_settings_are_refused(chosen):
    with pytest.raises(PuddleError, match="expected only one of a study's name, --preset and --settings, got --"):
        StudyOptions(**chosen)


def test_the_program_is_named_as_it_is_found_from_the_working_folder(tmp_path, monkeypatch):
    scripts = tmp_path / ".venv" / "bin"
    scripts.mkdir(parents=True)
    (scripts / "puddle").touch(mode=0o755)
    monkeypatch.setattr(sysconfig, "get_path", lambda name: str(scripts))
    monkeypatch.setenv("PATH", "/usr/bin")
    monkeypatch.chdir(tmp_path)
    assert program() == ".venv/bin/puddle"
    monkeypatch.chdir("/usr")
    assert program() == str(scripts / "puddle")
    monkeypatch.setenv("PATH", f"{scripts}:/usr/bin")  # the environment is active
    assert program() == "puddle"


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
