"""Encoding of tables (Parquet), arrays (safetensors) and documents (JSON) as bytes, and decoding. No disk access.

Equal values give equal bytes (with the same pyarrow), so that a digest can stand for the content. Each file names its
format, a schema and a version, in one JSON text under the key ``puddle`` of its metadata: safetensors writes several
keys in random order.
"""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq
import safetensors.numpy
from safetensors import SafetensorError

from pipeline.errors import DamagedArtifact, OtherVersion

Json: TypeAlias = "bool | int | float | str | Sequence[Json] | Mapping[str, Json] | None"
Array: TypeAlias = npt.NDArray[Any]

_METADATA_KEY = "puddle"


# -- digests and JSON ------------------------------------------------------------------------------------------------


def digest(data: bytes) -> str:
    """Return the SHA-256 of data in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def key_of(identity: Mapping[str, Json]) -> str:
    """Return a work item's key: the SHA-256 of its identity's canonical JSON."""
    return digest(canonical_json(identity))


def canonical_json(value: Json) -> bytes:
    """Return the unique JSON text of a value: sorted keys, no spaces, UTF-8, floats in their shortest exact form.

    Note that 1 and 1.0 differ, as do 0.0 and -0.0.

    Raises:
        TypeError: a value has no JSON form; convert NumPy scalars with int() or float() first.
        ValueError: a float is not finite, or a text is not valid Unicode.
    """
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()


def encode_json(value: Json) -> bytes:
    """Return indented canonical JSON with a newline at the end; raises as :func:`canonical_json`."""
    return json.dumps(value, sort_keys=True, indent=1, ensure_ascii=False, allow_nan=False).encode() + b"\n"


def decode_json(data: bytes, source: str) -> Any:
    """Return the value of a JSON document; refuse a number that is not finite."""
    try:
        value = json.loads(data.decode())
    except ValueError as error:
        raise DamagedArtifact(f"{source}: expected a JSON document (UTF-8): {error}") from None
    for place, number in _not_finite(value):
        where = f"{source}: {place}" if place else source
        raise DamagedArtifact(f"{where}: expected a finite number, got {number}")
    return value


def _not_finite(value: Any, place: str = "") -> Iterator[tuple[str, float]]:
    """Yield the places of numbers in a JSON value that are not finite, and these numbers."""
    if isinstance(value, float) and not math.isfinite(value):
        yield place, value
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from _not_finite(inner, f"{place}[{key}]" if isinstance(key, int) else f"{place}.{key}".lstrip("."))


# -- formats ---------------------------------------------------------------------------------------------------------


def check_format(found: Any, *, schema: str, version: int, source: str) -> None:
    """Refuse a document of another schema (DamagedArtifact) or version (OtherVersion)."""
    expected = f"expected {schema!r} version {version}"
    if not isinstance(found, dict) or found.get("schema") != schema or not isinstance(found.get("version"), int):
        got = found.get("schema") if isinstance(found, dict) else None
        what = repr(got) if isinstance(got, str) else "a file that puddle did not write"
        raise DamagedArtifact(f"{source}: {expected}, got {what}. Is it the right file?")
    if found["version"] != version:
        advice = (
            "A newer puddle wrote it: upgrade puddle."
            if found["version"] > version
            else "An older puddle wrote it: compute it again, or use that version of puddle."
        )
        raise OtherVersion(f"{source}: {expected}, got version {found['version']}. {advice}")


def encode_document(value: Mapping[str, Json], *, schema: str, version: int) -> bytes:
    """Return a JSON document that names its format."""
    return encode_json({**value, "schema": schema, "version": version})


def decode_document(data: bytes, *, schema: str, version: int, source: str) -> dict[str, Any]:
    """Return a JSON document of puddle's own, which messages call ``source``.

    Raises:
        OtherVersion: another version of puddle wrote it.
        DamagedArtifact: it is no such document.
    """
    value = decode_json(data, source)
    check_format(value, schema=schema, version=version, source=source)
    return dict(value)


# -- tables: Parquet -------------------------------------------------------------------------------------------------


def encode_table(
    columns: Mapping[str, Array], *, schema: str, version: int, units: Mapping[str, str] | None = None
) -> bytes:
    """Return a table as a Parquet file with zstd compression.

    Args:
        columns: by name, in order: numbers or flags of shape (n_rows,) or (n_rows, k), the latter stored as lists of
            k; or text of shape (n_rows,).
        schema, version: the table's format.
        units: units of columns, by name; SI where not named.
    """
    parts = [_arrow_column(array) for array in columns.values()]
    fields = [pa.field(name, part.type, nullable=False) for name, part in zip(columns, parts, strict=True)]
    label = canonical_json({"schema": schema, "version": version, "units": dict(units or {})})
    table = pa.Table.from_arrays(parts, schema=pa.schema(fields, metadata={_METADATA_KEY: label}))
    sink = pa.BufferOutputStream()
    texts = [name for name, array in columns.items() if array.dtype.kind == "U"]  # dictionaries of numbers save nothing
    pq.write_table(table, sink, compression="zstd", use_dictionary=texts, write_page_checksum=True)
    return bytes(sink.getvalue())


def decode_table(data: bytes, *, schema: str, version: int, source: str) -> dict[str, Array]:
    """Return the columns of a table, which messages call ``source``, as new, writable, C-contiguous arrays by name.

    Raises:
        DamagedArtifact, OtherVersion: the data are damaged or have another format.
    """
    try:
        file = pq.ParquetFile(pa.BufferReader(data), pre_buffer=False)
        check_format(_label_of(file, source), schema=schema, version=version, source=source)
        table = file.read(use_threads=False)
    except (pa.ArrowException, OSError) as error:
        raise DamagedArtifact(f"{source}: expected a Parquet file of {schema!r} version {version}: {error}") from None
    return {name: _numpy_column(table.column(name)) for name in table.column_names}


def units_of(data: bytes, source: str) -> dict[str, str]:
    """Return the units that a table states, by column; ``source`` is its name in messages."""
    return dict(_label_of(pq.ParquetFile(pa.BufferReader(data)), source)["units"])


def _label_of(file: pq.ParquetFile, source: str) -> Any:
    return decode_json((file.metadata.metadata or {}).get(_METADATA_KEY.encode(), b"null"), source)


def _arrow_column(array: Array) -> pa.Array:
    if array.ndim == 1:
        return pa.array(array.tolist(), pa.string()) if array.dtype.kind == "U" else pa.array(array)
    flat = pa.array(array.reshape(-1))
    row = pa.list_(pa.field("element", flat.type, nullable=False), array.shape[1])
    return pa.FixedSizeListArray.from_arrays(flat, type=row)


def _numpy_column(column: pa.ChunkedArray) -> Array:
    if pa.types.is_string(column.type):
        return np.array(column.to_pylist(), dtype=np.str_)
    if not pa.types.is_fixed_size_list(column.type):
        return np.array(column.to_numpy(), order="C")
    values = column.combine_chunks().flatten().to_numpy(zero_copy_only=False)
    return np.array(values).reshape(len(column), column.type.list_size)


# -- arrays: safetensors ---------------------------------------------------------------------------------------------


def encode_arrays(arrays: Mapping[str, Array], *, schema: str, version: int) -> bytes:
    """Return numbers or flags of any shape by name, such as a network's weights, as a safetensors file."""
    label = canonical_json({"schema": schema, "version": version}).decode()
    ordered = {name: np.asarray(arrays[name], order="C") for name in sorted(arrays)}
    return bytes(safetensors.numpy.save(ordered, metadata={_METADATA_KEY: label}))


def decode_arrays(data: bytes, *, schema: str, version: int, source: str) -> dict[str, Array]:
    """Return new, writable arrays by sorted name from a safetensors file, which messages call ``source``.

    Raises:
        DamagedArtifact, OtherVersion: the data are damaged or have another format.
    """
    try:
        loaded = safetensors.numpy.load(data)
    except SafetensorError as error:
        raise DamagedArtifact(
            f"{source}: expected a safetensors file of {schema!r} version {version}: {error}"
        ) from None
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    label = header.get("__metadata__", {}).get(_METADATA_KEY, "null")
    check_format(decode_json(label.encode(), source), schema=schema, version=version, source=source)
    return {name: np.array(loaded[name]) for name in sorted(loaded)}  # the loaded ones are read-only
