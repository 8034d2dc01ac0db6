"""Artifacts: arrays and documents as bytes, and back. Bytes in, bytes out; nothing here touches a disk.

Tables are Parquet, weights are safetensors, documents are JSON; there is no pickle. The same values always give the
same bytes (under the same pyarrow), so that a digest can stand for the content. Each file names its format (a schema
and a version) and carries a SHA-256 of its values: Parquet's page checksums leave its footer uncovered, safetensors
has none at all, and both otherwise accept a flipped bit without a word.

Everything that tables and arrays know about themselves is one JSON text under the metadata key ``puddle``. One key,
because safetensors writes several in a random order.
"""

from __future__ import annotations

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

METADATA_KEY = "puddle"

MAX_TABLE_BYTES = 2**31
"""Of a table in memory. A piece of work makes megabytes."""

_INTEGERS = tuple(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))
_NUMBERS = frozenset(("bool", *_INTEGERS, "float32", "float64"))
_RESTORE = "It is damaged: restore it from a copy, or make it again."


# -- digests and JSON ------------------------------------------------------------------------------------------------


def digest(data: bytes) -> str:
    """Return the SHA-256 of some bytes in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def key_of(identity: Mapping[str, Json]) -> str:
    """Return a work item's key: the SHA-256 of its identity's canonical JSON."""
    return digest(canonical_json(identity))


def canonical_json(value: Json) -> bytes:
    """Return the one JSON text of a value: sorted keys, no spaces, UTF-8, floats in their shortest exact form.

    Note that 1 and 1.0 differ, as do 0.0 and -0.0.

    Raises:
        TypeError: where a value is not a plain None, bool, int, float, str, list, tuple or dict with text keys. numpy
            scalars are refused: whoever hashes one says what it is, with int() or float().
        ValueError: where a float is not finite, or a text is not Unicode.
    """
    _refuse_impure(value, "")
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()


def encode_json(value: Json) -> bytes:
    """Return a document: canonical JSON laid out for reading, one newline at its end. Raises as canonical_json."""
    _refuse_impure(value, "")
    return json.dumps(value, sort_keys=True, indent=1, ensure_ascii=False, allow_nan=False).encode() + b"\n"


def decode_json(data: bytes, source: str) -> Any:
    """Return a document's value.

    Raises:
        PuddleError: names the source, where it is not JSON, names a key twice, or holds a number that is not finite.
    """
    try:
        value = json.loads(data.decode(), object_pairs_hook=_unique_keys)
        _refuse_impure(value, "")
        json.dumps(value, ensure_ascii=False).encode()  # an escaped half of a surrogate pair is no text
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
    """Refuse what JSON has no exact form for. Exact types: a numpy float64 is a float to isinstance."""
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
    """Refuse a document that is not of one format.

    Args:
        found: the document, which should be a dict with its ``schema`` and ``version``.
        schema: the name expected.
        version: the version expected.
        source: what to call the document in a message.

    Raises:
        PuddleError: says what came instead, and what to do.
    """
    expected = f"expected {schema!r} version {version}"
    if not isinstance(found, dict) or not isinstance(found.get("schema"), str) or type(found.get("version")) is not int:
        raise PuddleError(f"{source}: {expected}, came a file that puddle did not write. Is it the right file?")
    if found["schema"] != schema:
        raise PuddleError(f"{source}: {expected}, came {found['schema']!r}. Is it the right file?")
    if found["version"] > version:
        raise OtherVersion(
            f"{source}: {expected}, came version {found['version']}. A newer puddle wrote it: upgrade puddle."
        )
    if found["version"] < version:
        raise OtherVersion(
            f"{source}: {expected}, came version {found['version']}. "
            f"An older puddle wrote it: make it again, or use that version of puddle."
        )


def encode_sealed(value: Mapping[str, Json], *, schema: str, version: int) -> bytes:
    """Return a document that names its format and carries the SHA-256 of its own content."""
    named = {**value, "schema": schema, "version": version}
    return encode_json({**named, "sha256": digest(canonical_json(named))})


def decode_sealed(data: bytes, *, schema: str, version: int, source: str) -> dict[str, Any]:
    """Return a sealed document's value, without its seal.

    Raises:
        PuddleError: where the document is of another format.
        DamagedArtifact: where it is not, to the byte, what was written.
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
        raise DamagedArtifact(
            f"{source}: expected {schema!r} version {version}, came version {value['version']} and "
            "another SHA-256 than it says"
        ) from None
    if not _seal_holds(value, data):
        unsealed = {name: inner for name, inner in value.items() if name != "sha256"}
        raise DamagedArtifact(
            f"{source}: expected SHA-256 {value.get('sha256')}, came {digest(canonical_json(unsealed))}"
        )
    return _body(value)


def _body(document: Mapping[str, Any]) -> dict[str, Any]:
    return {name: inner for name, inner in document.items() if name not in ("schema", "version", "sha256")}


def _seal_holds(document: Mapping[str, Any], data: bytes) -> bool:
    """Tell whether a document is, to the byte, what was sealed: by this puddle, or by one of another version."""
    return encode_sealed(_body(document), schema=document["schema"], version=document["version"]) == data


# -- tables: Parquet -------------------------------------------------------------------------------------------------


def encode_table(
    columns: Mapping[str, Array], *, schema: str, version: int, producer: str, units: Mapping[str, str] | None = None
) -> bytes:
    """Return a table as Parquet, zstd within, a checksum on every page.

    Args:
        columns: by name, in order: (n_rows,) or (n_rows, k) numbers or flags, the latter kept as lists of k; or
            (n_rows,) text.
        schema: the name of the table's format.
        version: the version of the table's format.
        producer: the key of the work that made it.
        units: the columns' units, by name; SI where not named.

    Raises:
        TypeError: where a column is of a type that Parquet would not return unchanged.
        ValueError: where the shapes do not make a table, or a unit is of no column.
    """
    arrays = {name: _pure_array(array, name) for name, array in columns.items()}
    n_rows = {array.shape[0] if array.ndim in (1, 2) and 0 not in array.shape[1:] else -1 for array in arrays.values()}
    if len(n_rows) != 1 or -1 in n_rows:
        shapes = {name: array.shape for name, array in arrays.items()}
        raise ValueError(f"table {schema!r}: expected columns of (n_rows,) or (n_rows, k), came {shapes}")
    if strangers := set(units or {}) - set(arrays):
        raise ValueError(f"table {schema!r}: units for {sorted(strangers)}, which are not columns")
    label = _label(arrays, {"schema": schema, "version": version, "producer": producer, "units": dict(units or {})})
    parts = [_arrow_column(array) for array in arrays.values()]
    fields = [pa.field(name, part.type, nullable=False) for name, part in zip(arrays, parts, strict=True)]
    table = pa.Table.from_arrays(parts, schema=pa.schema(fields, metadata={METADATA_KEY: label}))
    sink = pa.BufferOutputStream()
    texts = [name for name, array in arrays.items() if array.dtype.kind == "U"]  # a dictionary of numbers saves nothing
    pq.write_table(table, sink, compression="zstd", use_dictionary=texts, write_page_checksum=True)
    return bytes(sink.getvalue())


def decode_table(data: bytes, *, schema: str, version: int, source: str) -> dict[str, Array]:
    """Return a table's columns, as they were given to :func:`encode_table`: own, writable, C-contiguous arrays.

    Raises:
        PuddleError: where the data are damaged or of another format; it names the source, what was expected and came.
    """
    try:
        metadata = pq.read_metadata(pa.BufferReader(data))
        label = _read_label((metadata.metadata or {}).get(METADATA_KEY.encode()), source)
        check_format(label, schema=schema, version=version, source=source)
        kinds = {field.name: field.type for field in metadata.schema.to_arrow_schema()}
        _refuse_swelling(metadata, kinds)
        texts = [name for name, kind in kinds.items() if pa.types.is_string(kind)]
        file = pq.ParquetFile(
            pa.BufferReader(data),
            metadata=metadata,
            read_dictionary=texts,  # each text once, however often it is there
            page_checksum_verification=True,
            pre_buffer=False,
        )
        table = file.read(use_threads=False)
        _refuse_beyond_memory(sum(_text_bytes(table.column(name)) for name in texts))
        columns = {name: _pure_array(_numpy_column(table.column(name)), name) for name in table.column_names}
    except (pa.ArrowException, OSError, ValueError, TypeError, KeyError, MemoryError) as error:
        raise PuddleError(
            f"{source}: expected a Parquet file of {schema!r} version {version}: {error}. {_RESTORE}"
        ) from None
    _check_label(columns, label, source)
    return columns


def _refuse_swelling(metadata: pq.FileMetaData, kinds: Mapping[str, pa.DataType]) -> None:
    """Refuse a table that would fill the memory: a few kilobytes can stand for many gigabytes."""
    width = sum(_width(name, kind) for name, kind in kinds.items())
    groups = [metadata.row_group(index) for index in range(metadata.num_row_groups)]
    _refuse_beyond_memory(max(metadata.num_rows * width, sum(group.total_byte_size for group in groups)))


def _refuse_beyond_memory(n_bytes: int) -> None:
    if n_bytes > MAX_TABLE_BYTES:
        raise ValueError(f"it would take {n_bytes} bytes of memory, {MAX_TABLE_BYTES} at most")


def _width(name: str, kind: pa.DataType) -> int:
    """Return the bytes that a value takes in memory; of text, which place has which."""
    if pa.types.is_string(kind):
        return 4
    if pa.types.is_fixed_size_list(kind) and pa.types.is_primitive(kind.value_type):
        return int(kind.list_size) * _width(name, kind.value_type)
    if not pa.types.is_primitive(kind):
        raise ValueError(f"column {name!r} is of {kind}, which no table of ours holds")
    return max(1, int(kind.bit_width) // 8)


def _text_bytes(column: pa.ChunkedArray) -> int:
    """Return the bytes that texts take in memory, read as a dictionary: numpy gives each the room of the longest."""
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
    """Return arrays of any shape as safetensors, for instance a network's weights.

    Args:
        arrays: numbers or flags by name; the order of names does not matter.
        metadata: what else there is to say of them, as text by name.
        schema: the name of the format, that is of the names and shapes to expect.
        version: the version of the format.
        producer: the key of the work that made them.

    Raises:
        TypeError: where an array is of text or of another type that safetensors would not return unchanged.
    """
    pure = {name: _pure_array(arrays[name], name, text=False) for name in sorted(arrays)}
    said: dict[str, Json] = {
        "schema": schema,
        "version": version,
        "producer": producer,
        "metadata": dict(metadata or {}),
    }
    return bytes(safetensors.numpy.save(pure, metadata={METADATA_KEY: _label(pure, said)}))


def decode_arrays(data: bytes, *, schema: str, version: int, source: str) -> tuple[dict[str, Array], dict[str, str]]:
    """Return the arrays, own and writable, by sorted name, and the metadata of :func:`encode_arrays`.

    Raises:
        PuddleError: where the data are damaged or of another format; it names the source, what was expected and came.
    """
    try:
        # The library's parser goes first: it bounds the header by the file's length and every tensor by its dtype.
        loaded = safetensors.numpy.load(data)
        header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
        said = header.get("__metadata__", {}).get(METADATA_KEY)
    except (SafetensorError, ValueError, TypeError, KeyError, AttributeError, MemoryError, RecursionError) as error:
        raise PuddleError(
            f"{source}: expected a safetensors file of {schema!r} version {version}: {error}. {_RESTORE}"
        ) from None
    label = _read_label(None if said is None else said.encode(), source)
    check_format(label, schema=schema, version=version, source=source)
    arrays = {name: np.array(loaded[name]) for name in sorted(loaded)}  # copies: the loaded ones are read-only
    _check_label(arrays, label, source)
    return arrays, label["metadata"]


# -- what tables and arrays say of themselves ------------------------------------------------------------------------


def _pure_array(array: Array, name: str, *, text: bool = True) -> Array:
    """Return the array in C order and little endian; refuse a type that would not come back as it went."""
    array = np.asarray(array, order="C")
    if not (array.dtype.name in _NUMBERS or (text and array.dtype.kind == "U" and array.ndim == 1)):
        expected = f"one of {', '.join(sorted(_NUMBERS))}{', or 1-D text (numpy str)' if text else ''}"
        raise TypeError(f"array {name!r} is {array.ndim}-D of {array.dtype}, expected {expected}")
    return array.astype(array.dtype.newbyteorder("<"), copy=False)


def _label(arrays: Mapping[str, Array], said: dict[str, Json]) -> str:
    """Return what a file says of itself, with a SHA-256 over that and over every name, type, shape and value."""
    return canonical_json({**said, "sha256": _content_digest(arrays, said)}).decode()


def _content_digest(arrays: Mapping[str, Array], said: dict[str, Json]) -> str:
    shapes: list[Json] = [
        [name, "text" if array.dtype.kind == "U" else array.dtype.str, array.shape] for name, array in arrays.items()
    ]
    content = hashlib.sha256(canonical_json([said, shapes]))
    for array in arrays.values():
        content.update(canonical_json(array.tolist()) if array.dtype.kind == "U" else array.data)
    return content.hexdigest()


def _read_label(said: bytes | None, source: str) -> dict[str, Any]:
    label = None if said is None else decode_json(said, f"{source}, metadata {METADATA_KEY!r}")
    return label if isinstance(label, dict) else {}


def _check_label(arrays: Mapping[str, Array], label: dict[str, Any], source: str) -> None:
    expected = label.pop("sha256", None)
    came = _content_digest(arrays, label)
    if came != expected:
        raise PuddleError(f"{source}: expected values of SHA-256 {expected}, came {came}. {_RESTORE}")
