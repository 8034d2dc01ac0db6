"""Text from files of others cannot act on a terminal."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.text import printable


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a line\n\tand another", "a line\n\tand another"),
        ("Größe ± 3 µm → 水", "Größe ± 3 µm → 水"),
        ("\x1b[2J\x1b]52;c;aGk=\x07", r"\u001b[2J\u001b]52;c;aGk=\u0007"),
        ("\x9b31m", r"\u009b31m"),
        ("back\rspace\x08\x7f", r"back\u000dspace\u0008\u007f"),
        ("evil\u202efdp.exe", r"evil\u202efdp.exe"),
        ("\udcff", r"\udcff"),
        ("one\u2028two", r"one\u2028two"),
    ],
)
def test_what_acts_on_a_terminal_is_escaped(text, shown):
    assert printable(text) == shown


@given(st.text())
def test_everything_can_be_printed_and_nothing_else_changes(text):
    shown = printable(text)
    shown.encode()
    assert all(one in "\n\t" or one.isprintable() or one not in text or ord(one) > 0x9F for one in shown)
    assert printable(shown) == shown
    assert json.loads(printable(json.dumps(text, ensure_ascii=False))) == text  # as `--json` prints it
