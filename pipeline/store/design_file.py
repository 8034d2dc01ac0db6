"""The design file, design.json: a schema version and the fields of one design."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import PuddleError
from pipeline.store.encoding import decode_json
from tasks.design import N_LINKS, DesignError, Designs, check
from tasks.design.genes import DTYPES, PER_DESIGN

DESIGN_SCHEMA, DESIGN_VERSION = "puddle.design", 1

_MAX_BYTES = 2**20


def design_document(design: Designs) -> dict[str, Any]:
    """Return one design as plain values."""
    fields = {name: array[0].tolist() for name, array in design.arrays()}
    return {"schema": DESIGN_SCHEMA, "version": DESIGN_VERSION, **fields}


def design_from(document: Any, source: str) -> Designs:
    """Return the design in a parsed design file, which messages call ``source``; the error names the faulty field."""
    if not isinstance(document, dict) or document.get("schema") != DESIGN_SCHEMA:
        raise PuddleError(f'{source}: not a design: expected a JSON object with "schema": "{DESIGN_SCHEMA}"')
    if document.get("version") != DESIGN_VERSION:
        raise PuddleError(
            f"{source}: version: expected {DESIGN_VERSION}, got {document.get('version')!r}. Try a newer puddle."
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
    special: dict[Any, tuple[set[type], str]] = {np.bool_: ({bool}, "true or false"), np.int64: ({int}, "whole number")}
    kinds, word = special.get(DTYPES[name], ({int, float}, "number"))
    values, n_expected = ([value], 1) if name in PER_DESIGN else (value, N_LINKS)
    if not isinstance(values, list) or len(values) != n_expected or not {type(v) for v in values} <= kinds:
        expected = f"one {word}" if name in PER_DESIGN else f"a list of {N_LINKS} values, each a {word}"
        raise PuddleError(f"{source}: {name}: expected {expected}, got {json.dumps(value)[:100]}")
    try:
        return np.asarray(value, dtype=DTYPES[name])
    except OverflowError:
        raise PuddleError(f"{source}: {name}: expected 64-bit numbers, got {str(value)[:100]}") from None


def read_design(path: Path) -> Designs:
    """Read a design file."""
    try:
        with path.open("rb") as file:
            data = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise PuddleError(f"{path}: cannot be read: {error.strerror}. Expected a design file (design.json).") from None
    if len(data) > _MAX_BYTES:
        raise PuddleError(f"{path}: expected at most {_MAX_BYTES} bytes of a design, got more. Is it the right file?")
    return design_from(decode_json(data, str(path)), str(path))
