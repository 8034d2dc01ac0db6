"""Command lines that messages advise run from where the user stands, on the user's store."""

import sysconfig
from pathlib import Path

import pytest

from pipeline.commands.options import to_copy


@pytest.mark.parametrize(
    ("folder", "variable", "store", "expected"),
    [
        ("", "", "store", ".venv/bin/puddle gc"),
        ("", "", "my store", ".venv/bin/puddle gc --store 'my store'"),
        ("", "other", "other", ".venv/bin/puddle gc"),
        ("", "other", "store", ".venv/bin/puddle gc --store store"),
        (".venv", "", "store", "bin/puddle gc"),
        ("..", "", "store", "here/.venv/bin/puddle gc"),
        ("/usr", "", "store", "{root}/.venv/bin/puddle gc"),
    ],
)
def test_a_command_to_copy_finds_the_program_and_the_store(folder, variable, store, expected, tmp_path, monkeypatch):
    """The store is named unless it is the default, which the environment variable may set."""
    scripts = tmp_path / "here" / ".venv" / "bin"
    scripts.mkdir(parents=True)
    (scripts / "puddle").touch(mode=0o755)
    monkeypatch.setattr(sysconfig, "get_path", lambda name: str(scripts))
    monkeypatch.setenv("PATH", "/usr/bin")
    monkeypatch.setenv("PUDDLE_STORE", variable)
    monkeypatch.chdir(tmp_path / "here" / folder)
    assert to_copy("gc", Path(store)) == expected.format(root=tmp_path / "here")
    monkeypatch.setenv("PATH", str(scripts))
    assert to_copy("gc", Path(store)).startswith("puddle gc")
