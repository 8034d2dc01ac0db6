"""What a file that is no tracks file is, told by its first bytes or lines, and what to give in its place."""

import codecs
import re
from collections.abc import Mapping
from typing import AnyStr

import pyarrow as pa

from pipeline.errors import PuddleError

_CODECS = {rb"\x1f\x8b": "gzip", rb"BZh": "bz2", rb"\x28\xb5\x2f\xfd": "zstd"}
_KINDS = {
    rb"\x89HDF": "HDF5: export CSV (DeepLabCut: save_as_csv=True; SLEAP: Export Analysis CSV): docs/your-own-tank.md",
    rb"PK\x03\x04.*(xl/worksheets|opendocument)|\xd0\xcf\x11\xe0": "a workbook: save its sheet as CSV UTF-8",
    rb"PK\x03\x04": "a ZIP archive: unpack it, and name the file in it",
    rb".{4}ftyp": "a video: `puddle track` makes tracks of it",
    rb"\s*[\[{]": "JSON: write its table as CSV",
    rb"(\xef\xbb\xbf)?\s*<": "HTML or XML: open it in a spreadsheet, and save the sheet as CSV UTF-8",
    rb"(?!\xff\xfe|\xfe\xff).*\0": "a binary file: export its table as CSV",
}
TRACKERS = {
    r"scorer[,;\t]": "DeepLabCut",
    r"[^\n]*\bframe_idx\b[^\n]*\.x\b": "SLEAP",
    r"Format Version[,;\t]": "Motive",
    r"(Trajectories|Model Outputs|Segments|Objects)[,;\t]*\n\d": "Vicon",
    r'(#multi:|([^\n]*\n)?"?t( ?[\[(]\w+[\])])?\t)': "Tracker",
}


def decode(content: bytes, name: str) -> str:
    """Return the text of a file, compressed or not, in UTF-8, UTF-16 or Windows' encoding, or say what it is."""
    if codec := told_by(_CODECS, content):
        content = pa.CompressedInputStream(pa.BufferReader(content), codec).read()
    if kind := told_by(_KINDS, content):
        raise PuddleError(f"{name}: expected CSV or Parquet, got {kind}")
    try:
        utf_16 = content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
        text = content.decode("utf-16", "replace") if utf_16 else content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("cp1252", "replace")
    return "\n".join(text.splitlines())


def told_by(patterns: Mapping[AnyStr, str], content: AnyStr) -> str | None:
    """Return what the first of the patterns that fits the beginning of a content stands for."""
    return next((what for pattern, what in patterns.items() if re.match(pattern, content, re.DOTALL)), None)
