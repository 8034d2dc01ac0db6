"""A file that registers something may be a user's own: one that can't be imported keeps nothing else from working."""

import pytest

from tasks import discovery


@pytest.fixture
def imported(tmp_path, monkeypatch):
    """Import files of a package as the program does; return its failures."""
    monkeypatch.setattr(discovery, "FAILURES", [])
    monkeypatch.syspath_prepend(tmp_path)
    (folder := tmp_path / "extensions_of_a_user").mkdir()

    def call(**files: str) -> list[str]:
        for name, content in files.items():
            (folder / f"{name}.py").write_text(content)
        discovery.import_extensions(folder.name, [str(folder)])
        return [failure.removeprefix(f"{folder}/") for failure in discovery.FAILURES]

    return call


def test_a_file_that_fails_is_named_with_its_line_and_the_others_work(imported, tmp_path):
    failures = imported(
        call="def f(:\n",
        deep="import math\n\n\ndef f(x):\n    return math.sqrt(x)\n\n\nf(-1)\n",
        missing="\nimport nunpy\n",
        sound=f"open({str(tmp_path / 'ran')!r}, 'w')",
        words="raise ValueError('of\\ntwo lines')",
    )
    assert failures == [
        "call.py:1: SyntaxError: invalid syntax",
        "deep.py:5: ValueError: math domain error",
        "missing.py:2: ModuleNotFoundError: No module named 'nunpy'",
        "words.py:1: ValueError: of two lines",
    ]
    assert (tmp_path / "ran").exists()
