"""What a file that is no tracks file is, told by its first bytes or lines, and what to give in its place."""

import codecs
import re

import pyarrow as pa

from pipeline.errors import PuddleError

_CODECS = {b"\x1f\x8b": "gzip", b"BZh": "bz2", b"\x28\xb5\x2f\xfd": "zstd"}
_KINDS = {
    rb"\x89HDF": "HDF5, as DeepLabCut and SLEAP write it: export CSV (DeepLabCut: save_as_csv=True; SLEAP: Export "
    "Analysis CSV), and convert that as in docs/your-own-tank.md",
    rb"PK\x03\x04.*(xl/worksheets|opendocument)": "a workbook: save its sheet as CSV UTF-8",
    rb"PK\x03\x04": "a ZIP archive: unpack it, and name the file in it",
    rb"\xd0\xcf\x11\xe0": "an old workbook (.xls): save its sheet as CSV UTF-8",
    rb".{4}ftyp": "a video: `puddle track` makes tracks of it",
    rb"\s*[\[{]": "JSON: write its table as CSV",
    rb"(\xef\xbb\xbf)?\s*<": "HTML or XML: open it in a spreadsheet, and save the sheet as CSV UTF-8",
}
_PROGRAMS = {
    r"scorer[,;\t]": ("DeepLabCut", "two points of each bar"),
    r".*\bframe_idx\b.*\.x\b": ("SLEAP", "two points of each bar"),
    r"Format Version[,;\t]": ("Motive", "a rigid body's position and rotation"),
    r"(Trajectories|Model Outputs|Segments|Objects)[,;\t]*\n\d+": ("Vicon", "two markers of each bar"),
    r"(#multi:|(.*\n)?\"?t( ?[\[(]\w+[\])])?\t)": ("Tracker", "two points of each bar"),
}


def decompress(content: bytes, name: str) -> bytes:
    """Return what a compressed file holds, and any other as it is. Raises PuddleError if it is damaged."""
    codec = next((codec for first, codec in _CODECS.items() if content.startswith(first)), None)
    try:
        return content if codec is None else pa.CompressedInputStream(pa.BufferReader(content), codec).read()
    except OSError as error:
        raise PuddleError(f"{name}: expected a whole file compressed by {codec}: {error}") from None


def decode(content: bytes, name: str) -> str:
    """Return the text of a file in UTF-8, UTF-16 or Windows' encoding, with Unix's ends of lines.

    Raises:
        PuddleError: it is no text; the message says what it is and how to export text.
    """
    kind = next((kind for pattern, kind in _KINDS.items() if re.match(pattern, content, re.DOTALL)), None)
    try:
        text = content.decode("utf-16" if content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else "utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("cp1252", errors="replace")
    if kind or "\0" in text:
        raise PuddleError(f"{name}: expected CSV or Parquet, got {kind or 'a binary file: export its table as CSV'}")
    return "\n".join(text.splitlines())


def refuse_programs(text: str, name: str, columns: str) -> None:
    """Raise PuddleError if a text is another program's table, of which the ``columns`` have yet to be made."""
    for pattern, (program, parts) in _PROGRAMS.items():
        if re.match(pattern, text):
            raise PuddleError(
                f"{name}: a table as {program} writes it: expected the columns {columns}: make them from {parts} as in "
                f"docs/your-own-tank.md"
            )
