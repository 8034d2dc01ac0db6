"""Encoding of tables (Parquet), arrays (safetensors) and documents (JSON) as bytes, and decoding. No disk access.

Equal values give equal bytes (with the same pyarrow), so that a digest can stand for the content. Each file names its
format (a schema and a version) and carries the SHA-256 of its values, because Parquet's page checksums do not cover its
footer, safetensors has no checksums, and both otherwise accept a flipped bit silently. The metadata of a table or of
arrays is one JSON text under the key ``puddle``: safetensors writes several keys in random order.
"""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import safetensors.numpy
from safetensors import SafetensorError

from pipeline.errors import DamagedArtifact, OtherVersion, PuddleError

Json: TypeAlias = "bool | int | float | str | Sequence[Json] | Mapping[str, Json] | None"
Array: TypeAlias = npt.NDArray[Any]

MAX_TABLE_BYTES = 2**31  # largest table in memory [bytes]; a work item produces megabytes

_METADATA_KEY = "puddle"
_INTEGERS = tuple(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))
_NUMBERS = frozenset(("bool", *_INTEGERS, "float32", "float64"))
_RESTORE = "The file is damaged: restore it from a copy, or compute it again."


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
        TypeError: a value has another type than these; convert NumPy scalars with int() or float() first.
        ValueError: a float is not finite, or a text is not valid Unicode.
    """
    _refuse_impure(value, "")
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()


def encode_json(value: Json) -> bytes:
    """Return indented canonical JSON with a newline at the end; raises as :func:`canonical_json`."""
    _refuse_impure(value, "")
    return json.dumps(value, sort_keys=True, indent=1, ensure_ascii=False, allow_nan=False).encode() + b"\n"


def decode_json(data: bytes, source: str) -> Any:
    """Return the value of a JSON document; refuse a repeated key, and a number that is not finite."""
    try:
        value = json.loads(data.decode(), object_pairs_hook=_unique_keys)
        _refuse_impure(value, "")
        json.dumps(value, ensure_ascii=False).encode()  # fails for an unpaired surrogate
    except (ValueError, RecursionError) as error:
        problem = "nested too deeply" if isinstance(error, RecursionError) else str(error)
        raise PuddleError(f"{source}: expected a JSON document (UTF-8): {problem}") from None
    return value


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    value = dict(pairs)
    if len(value) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"the key {next(name for name in names if names.count(name) > 1)!r} appears twice")
    return value


def _refuse_impure(value: Any, where: str) -> None:
    """Refuse values without an exact JSON form. Types are compared exactly: np.float64 is a subclass of float."""
    kind = type(value)
    if kind is float:
        if not math.isfinite(value):
            raise ValueError(f"JSON: {where or 'the value'} is {value}, expected a finite number")
    elif kind is dict:
        for name, inner in value.items():
            if type(name) is not str:
                raise TypeError(f"JSON: {where or 'the value'} has the key {name!r}, expected text")
            _refuse_impure(inner, f"{where}.{name}")
    elif kind in (list, tuple):
        for index, inner in enumerate(value):
            _refuse_impure(inner, f"{where}[{index}]")
    elif value is not None and kind not in (bool, int, str):
        raise TypeError(
            f"JSON: {where or 'the value'} is a {kind.__module__}.{kind.__qualname__}, "
            f"expected None, bool, int, float, str, list, tuple or dict"
        )


# -- formats ---------------------------------------------------------------------------------------------------------


def check_format(found: Any, *, schema: str, version: int, source: str) -> None:
    """Refuse a document of another format.

    Args:
        found: the document, which should be a dict with ``schema`` and ``version``.
        schema, version: the expected format.
        source: the document's name in messages.

    Raises:
        PuddleError: the document has another format.
        OtherVersion: it has another version of this format.
    """
    expected = f"expected {schema!r} version {version}"
    if not isinstance(found, dict) or not isinstance(found.get("schema"), str) or type(found.get("version")) is not int:
        raise PuddleError(f"{source}: {expected}, got a file that puddle did not write. Is it the right file?")
    if found["schema"] != schema:
        raise PuddleError(f"{source}: {expected}, got {found['schema']!r}. Is it the right file?")
    if found["version"] != version:
        advice = (
            "A newer puddle wrote it: upgrade puddle."
            if found["version"] > version
            else "An older puddle wrote it: compute it again, or use that version of puddle."
        )
        raise OtherVersion(f"{source}: {expected}, got version {found['version']}. {advice}")


def encode_sealed(value: Mapping[str, Json], *, schema: str, version: int) -> bytes:
    """Return a JSON document that names its format and carries the SHA-256 of its own content.

    Args:
        value: the content.
        schema, version: the format.
    """
    named = {**value, "schema": schema, "version": version}
    return encode_json({**named, "sha256": digest(canonical_json(named))})


def decode_sealed(data: bytes, *, schema: str, version: int, source: str) -> dict[str, Any]:
    """Return the content of a sealed document, without its format and seal.

    Args:
        data: the document.
        schema, version: the expected format.
        source: the document's name in messages.

    Raises:
        PuddleError: the document has another format.
        DamagedArtifact: it differs in any byte from what was written.
    """
    try:
        value = decode_json(data, source)
    except PuddleError as error:
        raise DamagedArtifact(str(error)) from None
    try:
        check_format(value, schema=schema, version=version, source=source)
    except OtherVersion:
        if _seal_holds(value, data):
            raise
        got = f"version {value['version']} and a SHA-256 that does not match"
        raise DamagedArtifact(f"{source}: expected {schema!r} version {version}, got {got}") from None
    if not _seal_holds(value, data):
        found = digest(canonical_json({name: inner for name, inner in value.items() if name != "sha256"}))
        raise DamagedArtifact(f"{source}: expected SHA-256 {value.get('sha256')}, got {found}")
    return _body(value)


def _body(document: Mapping[str, Any]) -> dict[str, Any]:
    return {name: inner for name, inner in document.items() if name not in ("schema", "version", "sha256")}


def _seal_holds(document: Mapping[str, Any], data: bytes) -> bool:
    """Check that a document equals its sealed form byte for byte, whatever version of puddle sealed it."""
    return encode_sealed(_body(document), schema=document["schema"], version=document["version"]) == data


# -- tables: Parquet -------------------------------------------------------------------------------------------------


def encode_table(
    columns: Mapping[str, Array], *, schema: str, version: int, producer: str, units: Mapping[str, str] | None = None
) -> bytes:
    """Return a table as a Parquet file with zstd compression and a checksum on every page.

    Args:
        columns: by name, in order: numbers or flags of shape (n_rows,) or (n_rows, k), the latter stored as lists of
            k; or text of shape (n_rows,).
        schema, version: the table's format.
        producer: key of the work item that produced it.
        units: units of columns, by name; SI where not named.

    Raises:
        TypeError: Parquet would not return a column's type unchanged.
        ValueError: the shapes do not form a table, or a unit belongs to no column.
    """
    arrays = {name: _pure_array(array, name) for name, array in columns.items()}
    n_rows = {array.shape[0] if array.ndim in (1, 2) and 0 not in array.shape[1:] else -1 for array in arrays.values()}
    if len(n_rows) != 1 or -1 in n_rows:
        shapes = {name: array.shape for name, array in arrays.items()}
        raise ValueError(f"table {schema!r}: expected columns of (n_rows,) or (n_rows, k), got {shapes}")
    if strangers := set(units or {}) - set(arrays):
        raise ValueError(f"table {schema!r}: units for {sorted(strangers)}, which are not columns")
    label = _label(arrays, {"schema": schema, "version": version, "producer": producer, "units": dict(units or {})})
    parts = [_arrow_column(array) for array in arrays.values()]
    fields = [pa.field(name, part.type, nullable=False) for name, part in zip(arrays, parts, strict=True)]
    table = pa.Table.from_arrays(parts, schema=pa.schema(fields, metadata={_METADATA_KEY: label}))
    sink = pa.BufferOutputStream()
    texts = [name for name, array in arrays.items() if array.dtype.kind == "U"]  # dictionaries of numbers save nothing
    pq.write_table(table, sink, compression="zstd", use_dictionary=texts, write_page_checksum=True)
    return bytes(sink.getvalue())


def decode_table(data: bytes, *, schema: str, version: int, source: str) -> dict[str, Array]:
    """Return the columns of a table by name, as new, writable, C-contiguous arrays.

    Args:
        data: the Parquet file.
        schema, version: the expected format.
        source: the table's name in messages.

    Raises:
        PuddleError: the data are damaged or have another format.
    """
    try:
        metadata = pq.read_metadata(pa.BufferReader(data))
        label = _read_label((metadata.metadata or {}).get(_METADATA_KEY.encode()), source)
        check_format(label, schema=schema, version=version, source=source)
        kinds = {field.name: field.type for field in metadata.schema.to_arrow_schema()}
        _refuse_beyond_memory(_bytes_in_memory(metadata, kinds))
        texts = [name for name, kind in kinds.items() if pa.types.is_string(kind)]
        options = {"metadata": metadata, "page_checksum_verification": True, "pre_buffer": False}
        file = pq.ParquetFile(pa.BufferReader(data), read_dictionary=texts, **options)  # each distinct text once
        table = file.read(use_threads=False)
        _refuse_beyond_memory(sum(_text_bytes(table.column(name)) for name in texts))
        columns = {name: _pure_array(_numpy_column(table.column(name)), name) for name in table.column_names}
    except (pa.ArrowException, OSError, ValueError, TypeError, KeyError, MemoryError) as error:
        expected = f"expected a Parquet file of {schema!r} version {version}"
        raise PuddleError(f"{source}: {expected}: {error}. {_RESTORE}") from None
    _check_label(columns, label, source)
    return columns


def units_of(data: bytes, source: str) -> dict[str, str]:
    """Return the units that a table states, by column; ``source`` is its name in messages."""
    metadata = pq.read_metadata(pa.BufferReader(data)).metadata or {}
    return dict(_read_label(metadata.get(_METADATA_KEY.encode()), source).get("units", {}))


def _bytes_in_memory(metadata: pq.FileMetaData, kinds: Mapping[str, pa.DataType]) -> int:
    width = sum(_width(name, kind) for name, kind in kinds.items())
    groups = [metadata.row_group(index) for index in range(metadata.num_row_groups)]
    return int(max(metadata.num_rows * width, sum(group.total_byte_size for group in groups)))


def _refuse_beyond_memory(n_bytes: int) -> None:
    """Refuse a table that would fill the memory: a few compressed kilobytes can expand to many gigabytes."""
    if n_bytes > MAX_TABLE_BYTES:
        raise ValueError(f"expected at most {MAX_TABLE_BYTES} bytes in memory, got {n_bytes}")


def _width(name: str, kind: pa.DataType) -> int:
    """Return the memory of one value [bytes]; for text, that of its dictionary index."""
    if pa.types.is_string(kind):
        return 4
    if pa.types.is_fixed_size_list(kind) and pa.types.is_primitive(kind.value_type):
        return int(kind.list_size) * _width(name, kind.value_type)
    if not pa.types.is_primitive(kind):
        raise ValueError(f"column {name!r} has type {kind}, which puddle does not write")
    return max(1, int(kind.bit_width) // 8)


def _text_bytes(column: pa.ChunkedArray) -> int:
    """Return the memory of a text column [bytes]; NumPy gives every text the size of the longest."""
    lengths = [pc.max(pc.utf8_length(chunk.dictionary)).as_py() or 0 for chunk in column.chunks]
    return 4 * max(lengths, default=0) * len(column)


def _arrow_column(array: Array) -> pa.Array:
    if array.ndim == 1:
        return pa.array(array.tolist(), pa.string()) if array.dtype.kind == "U" else pa.array(array)
    flat = pa.array(array.reshape(-1))
    row = pa.list_(pa.field("element", flat.type, nullable=False), array.shape[1])
    return pa.FixedSizeListArray.from_arrays(flat, type=row)


def _numpy_column(column: pa.ChunkedArray) -> Array:
    if pa.types.is_dictionary(column.type):
        return np.array(column.cast(pa.string()).to_pylist(), dtype=np.str_)
    if not pa.types.is_fixed_size_list(column.type):
        return np.array(column.to_numpy(), order="C")
    k = column.type.list_size
    parts = [chunk.flatten().to_numpy(zero_copy_only=False) for chunk in column.chunks]
    empty = np.empty(0, column.type.value_type.to_pandas_dtype())
    return np.concatenate([empty, *parts]).reshape(len(column), k)


# -- arrays: safetensors ---------------------------------------------------------------------------------------------


def encode_arrays(
    arrays: Mapping[str, Array], metadata: Mapping[str, str] | None = None, *, schema: str, version: int, producer: str
) -> bytes:
    """Return arrays of any shape, such as a network's weights, as a safetensors file.

    Args:
        arrays: numbers or flags by name; the order of names does not matter.
        metadata: further text by name.
        schema, version: the format.
        producer: key of the work item that produced them.

    Raises:
        TypeError: safetensors would not return an array's type unchanged.
    """
    pure = {name: _pure_array(arrays[name], name, text=False) for name in sorted(arrays)}
    texts = dict(metadata or {})
    label = _label(pure, {"schema": schema, "version": version, "producer": producer, "metadata": texts})
    return bytes(safetensors.numpy.save(pure, metadata={_METADATA_KEY: label}))


def decode_arrays(data: bytes, *, schema: str, version: int, source: str) -> tuple[dict[str, Array], dict[str, str]]:
    """Return new, writable arrays by sorted name, and their metadata.

    Args:
        data: the safetensors file.
        schema, version: the expected format.
        source: the file's name in messages.

    Raises:
        PuddleError: the data are damaged or have another format.
    """
    try:
        # The library's parser goes first: it bounds the header by the file's length and every tensor by its dtype.
        loaded = safetensors.numpy.load(data)
        header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
        said = header.get("__metadata__", {}).get(_METADATA_KEY)
    except (SafetensorError, ValueError, TypeError, KeyError, AttributeError, MemoryError, RecursionError) as error:
        expected = f"expected a safetensors file of {schema!r} version {version}"
        raise PuddleError(f"{source}: {expected}: {error}. {_RESTORE}") from None
    label = _read_label(None if said is None else said.encode(), source)
    check_format(label, schema=schema, version=version, source=source)
    arrays = {name: np.array(loaded[name]) for name in sorted(loaded)}  # copies: the loaded ones are read-only
    _check_label(arrays, label, source)
    return arrays, label["metadata"]


# -- the label of tables and arrays ----------------------------------------------------------------------------------


def _pure_array(array: Array, name: str, *, text: bool = True) -> Array:
    """Return an array in C order and little endian; refuse types that would not survive a round trip."""
    array = np.asarray(array, order="C")
    if not (array.dtype.name in _NUMBERS or (text and array.dtype.kind == "U" and array.ndim == 1)):
        expected = f"one of {', '.join(sorted(_NUMBERS))}{', or 1-D text (numpy str)' if text else ''}"
        raise TypeError(f"array {name!r} is {array.ndim}-D of {array.dtype}, expected {expected}")
    return array.astype(array.dtype.newbyteorder("<"), copy=False)


def _label(arrays: Mapping[str, Array], said: dict[str, Json]) -> str:
    """Return a file's label: its metadata and a SHA-256 over that and every name, type, shape and value."""
    return canonical_json({**said, "sha256": _content_digest(arrays, said)}).decode()


def _content_digest(arrays: Mapping[str, Array], said: dict[str, Json]) -> str:
    kinds = ["text" if array.dtype.kind == "U" else array.dtype.str for array in arrays.values()]
    shapes: list[Json] = [[name, kind, arrays[name].shape] for name, kind in zip(arrays, kinds, strict=True)]
    content = hashlib.sha256(canonical_json([said, shapes]))
    for array in arrays.values():
        content.update(canonical_json(array.tolist()) if array.dtype.kind == "U" else array.data)
    return content.hexdigest()


def _read_label(said: bytes | None, source: str) -> dict[str, Any]:
    label = None if said is None else decode_json(said, f"{source}, metadata {_METADATA_KEY!r}")
    return label if isinstance(label, dict) else {}


def _check_label(arrays: Mapping[str, Array], label: dict[str, Any], source: str) -> None:
    expected = label.pop("sha256", None)
    found = _content_digest(arrays, label)
    if found != expected:
        raise PuddleError(f"{source}: expected values of SHA-256 {expected}, got {found}. {_RESTORE}")
