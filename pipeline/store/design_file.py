"""design.json: how a design travels. A schema version and the fields of one design, each by its name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import PuddleError
from pipeline.store.encoding import decode_json
from tasks.design import N_LINKS, DesignError, Designs, check
from tasks.design.genes import DTYPES, PER_DESIGN

SCHEMA, VERSION = "puddle.design", 1

MAX_BYTES = 2**20
"""A design file's greatest length."""


def design_document(design: Designs) -> dict[str, Any]:
    """Give one design as plain values."""
    fields = {name: array[0].tolist() for name, array in design.arrays()}
    return {"schema": SCHEMA, "version": VERSION, **fields}


def design_from(document: Any, source: str) -> Designs:
    """Read one design out of plain values.

    Raises:
        PuddleError: names the source and the field, what was expected and what came.
    """
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise PuddleError(f'{source}: not a design: expected a JSON object with "schema": "{SCHEMA}"')
    if document.get("version") != VERSION:
        raise PuddleError(
            f"{source}: version: expected {VERSION}, came {document.get('version')!r}. A newer puddle may read it."
        )
    unknown = sorted(document.keys() - DTYPES.keys() - {"schema", "version"})
    missing = sorted(DTYPES.keys() - document.keys())
    if unknown or missing:
        said = [f"unknown field {unknown[0]}"] if unknown else []
        raise PuddleError(f"{source}: {', '.join(said + [f'missing field {name}' for name in missing])}")
    try:
        arrays = {name: _field(name, document[name], source)[None] for name in DTYPES}
        design = Designs(**arrays)
        check(design)
    except DesignError as error:
        raise PuddleError(f"{source}: {str(error).removeprefix('design 0: ')}") from None
    return design


def _field(name: str, value: Any, source: str) -> Any:
    """Check a field's type and length; its bounds are checked with the whole design."""
    kinds: tuple[type, ...] = {np.bool_: (bool,), np.int64: (int,)}.get(DTYPES[name], (int, float))
    values, n_expected = ([value], 1) if name in PER_DESIGN else (value, N_LINKS)
    word = {np.bool_: "true or false", np.int64: "whole number"}.get(DTYPES[name], "number")
    if (
        not isinstance(values, list)
        or len(values) != n_expected
        or not all(isinstance(v, kinds) and (bool in kinds or not isinstance(v, bool)) for v in values)
    ):
        expected = f"one {word}" if name in PER_DESIGN else f"a list of {N_LINKS} values, each a {word}"
        raise PuddleError(f"{source}: {name}: expected {expected}, came {json.dumps(value)[:100]}")
    try:
        return np.asarray(value, dtype=DTYPES[name])
    except OverflowError:
        raise PuddleError(f"{source}: {name}: expected numbers of a design's size, came {str(value)[:100]}") from None


def read_design(path: Path) -> Designs:
    """Read a design file.

    Raises:
        PuddleError: the file can't be read or is not a design.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise PuddleError(f"{path}: can't be read: {error.strerror}. Expected a design file (design.json).") from None
    if len(data) > MAX_BYTES:
        raise PuddleError(f"{path}: expected at most {MAX_BYTES} bytes of a design, came more. Is it the right file?")
    return design_from(decode_json(data, str(path)), str(path))
