"""Text from files of others, made safe to show."""

import html
import unicodedata

_PLAIN = "\n\t"
_UNSAFE_CATEGORIES = {
    "Cc",  # control characters: ESC moves the cursor, sets colours and the clipboard
    "Cs",  # surrogates, which have no encoding
    "Zl",  # line and paragraph separators
    "Zp",
}
_BIDIRECTIONAL = (
    "\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"  # these reorder what is read
)


def printable(text: str) -> str:
    r"""Replace the characters that act on a terminal or reorder a line by their escapes, such as ``\u001b``."""
    if text.isascii() and text.replace("\n", "").replace("\t", "").isprintable():
        return text
    return "".join(f"\\u{ord(one):04x}" if _is_unsafe(one) else one for one in text)


def _is_unsafe(character: str) -> bool:
    unsafe = unicodedata.category(character) in _UNSAFE_CATEGORIES or character in _BIDIRECTIONAL
    return unsafe and character not in _PLAIN


def escape(text: str) -> str:
    """Return text for HTML: with its special characters as entities, and what reorders a line as escapes."""
    return html.escape(printable(text))
