"""Command lines that messages advise carry the user's own options, and run from where the user stands."""

import sysconfig
from pathlib import Path

import pytest

from pipeline.commands import options
from pipeline.commands.options import StudyOptions, program


@pytest.mark.parametrize(
    ("variable", "chosen", "expected"),
    [
        ("", {}, "puddle train"),  # as typer takes it
        ("", {"store": Path("other")}, "puddle train --store other"),
        ("other", {"store": Path("other")}, "puddle train"),
        ("other", {"store": Path("store")}, "puddle train --store store"),
        ("", {"study": "mine"}, "puddle train mine"),
        ("", {"study": "mine"}, "puddle train mine"),
        ("", {"preset": "row"}, "puddle train --preset row"),
        ("", {"preset": "laptop"}, "puddle train"),
        (
            "",
            {"settings_file": Path("my file.yaml"), "overrides": ["seed=2"]},
            "puddle train --settings 'my file.yaml' --set seed=2",
        ),
    ],
)
def test_an_advised_command_has_the_same_settings_and_store(variable, chosen, expected, monkeypatch):
    """The store is named unless it is the default, which the environment variable may set."""
    monkeypatch.setenv("PUDDLE_STORE", variable)
    monkeypatch.setattr(options, "program", lambda: "puddle")
    assert StudyOptions(**chosen).command("train") == expected


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
