"""Artifacts come back as they went, always as the same bytes, and never damaged without a word."""

import json
import re
from collections.abc import Callable

import duckdb
import hypothesis.strategies as st
import numpy as np
import polars
import pytest
from hypothesis import given
from hypothesis.extra.numpy import arrays as numpy_arrays

from pipeline.errors import PuddleError
from pipeline.store.encoding import (
    canonical_json,
    decode_arrays,
    decode_document,
    decode_json,
    decode_table,
    encode_arrays,
    encode_document,
    encode_json,
    encode_table,
    key_of,
)

FORMAT = {"schema": "test.format", "version": 3}
NUMBERS = ("bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "float32", "float64")


def example_columns(n_rows: int = 40) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(5)
    return {
        "fitness": np.where(rng.random(n_rows) < 0.2, np.nan, rng.normal(size=n_rows)),
        "parent": rng.integers(-1, 5, (n_rows, 6)),
        "motor_on": rng.random((n_rows, 6)) < 0.5,
        "mass": rng.random((n_rows, 3)).astype(np.float32),
        "operator": np.array(["mutation", "crossover", "μ"])[rng.integers(0, 3, n_rows)],
        "diverged": rng.random(n_rows) < 0.5,
        "age": np.arange(n_rows, dtype=np.uint16),
    }


def example_table() -> bytes:
    return encode_table(example_columns(), **FORMAT, units={"fitness": "m", "mass": "kg"})


def example_arrays() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(6)
    weights = {f"layer{i}.weight": rng.normal(size=(4, 3)).astype(np.float32) for i in range(3)}
    return {**weights, "scale": np.float64(2.5), "none": np.zeros((0, 7), np.int8), "on": np.array([True, False])}


def same(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> bool:
    """Whether names, types, shapes and bits agree; NaN equals NaN."""
    return a.keys() == b.keys() and all(
        np.shape(a[name]) == b[name].shape and np.asarray(a[name]).tobytes() == b[name].tobytes() for name in a
    )


def test_a_table_comes_back_as_it_went_in_arrays_of_its_own() -> None:
    columns = example_columns()
    found = decode_table(example_table(), **FORMAT, source="history.parquet")
    assert list(found) == list(columns)
    for name, array in found.items():
        assert array.dtype == columns[name].dtype
        assert array.flags.writeable and array.flags.c_contiguous
    assert same(columns, found)


@given(data=st.data(), dtype=st.sampled_from(NUMBERS), n_rows=st.integers(0, 9), k=st.none() | st.integers(1, 4))
def test_numbers_of_every_type_and_shape_come_back(data: st.DataObject, dtype: str, n_rows: int, k: int | None) -> None:
    column = data.draw(numpy_arrays(dtype, (n_rows,) if k is None else (n_rows, k)))
    found = decode_table(encode_table({"x": column}, **FORMAT), **FORMAT, source="t")["x"]
    assert found.dtype == column.dtype and found.shape == column.shape
    np.testing.assert_array_equal(found, column)


def test_values_count_and_not_how_they_lie_in_memory() -> None:
    grid = np.arange(12.0).reshape(4, 3)
    assert encode_table({"x": grid.T}, **FORMAT) == encode_table({"x": grid.T.copy()}, **FORMAT)
    assert encode_arrays({"x": grid.T}, **FORMAT) == encode_arrays({"x": grid.T.copy()}, **FORMAT)
    columns = {"x": np.arange(2_200_000).reshape(-1, 2)}  # pyarrow begins another row group after 2^20 rows
    assert same(columns, decode_table(encode_table(columns, **FORMAT), **FORMAT, source="t"))


def test_duckdb_and_polars_read_lists_and_the_label(tmp_path) -> None:
    path = tmp_path / "history.parquet"
    path.write_bytes(example_table())
    columns = example_columns()
    rows = duckdb.sql(f"select parent, motor_on, operator, mass[2], fitness from '{path}'").fetchall()
    expected = (columns["parent"], columns["motor_on"], columns["operator"], columns["mass"][:, 1], columns["fitness"])
    for found, column in zip(zip(*rows, strict=True), expected, strict=True):
        np.testing.assert_array_equal(found, column)
    np.testing.assert_array_equal(polars.read_parquet(path)["mass"].to_numpy(), columns["mass"])
    said = duckdb.sql(f"select value from parquet_kv_metadata('{path}') where key = 'puddle'").fetchall()
    label = json.loads(bytes(said[0][0]))
    assert label == {**FORMAT, "units": {"fitness": "m", "mass": "kg"}}


def test_arrays_come_back_in_order_of_name() -> None:
    arrays = example_arrays()
    data = encode_arrays(arrays, **FORMAT)
    found = decode_arrays(data, **FORMAT, source="w")
    assert list(found) == sorted(arrays)
    assert all(array.flags.writeable for array in found.values())
    assert same(dict(sorted(arrays.items())), found)
    assert encode_arrays(dict(reversed(arrays.items())), **FORMAT) == data


DECODE: dict[str, Callable[[bytes], object]] = {
    "table": lambda data: decode_table(data, **FORMAT, source="the file"),
    "arrays": lambda data: decode_arrays(data, **FORMAT, source="the file"),
    "document": lambda data: decode_document(data, **FORMAT, source="the file"),
}


@pytest.mark.parametrize("kind", DECODE)
@given(data=st.binary(max_size=300))
def test_any_bytes_are_refused(kind: str, data: bytes) -> None:
    with pytest.raises(PuddleError, match="the file"):
        DECODE[kind](data)


@pytest.mark.parametrize("kind", DECODE)
@pytest.mark.parametrize(
    ("found", "message"),
    [
        ({"schema": "test.other", "version": 3}, "expected 'test.format' version 3, got 'test.other'"),
        ({"schema": 3, "version": 3}, "got a file that puddle did not write"),
        ({"schema": "test.format", "version": 4}, "got version 4. A newer puddle wrote it: upgrade puddle"),
        ({"schema": "test.format", "version": 2}, "got version 2. An older puddle wrote it: compute it again"),
    ],
)
def test_other_formats_and_versions_are_refused(kind: str, found: dict[str, object], message: str) -> None:
    data = {
        "table": lambda: encode_table({"x": np.zeros(2)}, **found),
        "arrays": lambda: encode_arrays({"x": np.zeros(2)}, **found),
        "document": lambda: encode_document({}, **found),
    }[kind]()
    with pytest.raises(PuddleError, match=f"the file: .*{message}"):
        DECODE[kind](data)


TEXT = st.text(st.characters(codec="utf-8"))
PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | TEXT,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXT, inner, max_size=4),
    max_leaves=20,
)


@given(PLAIN)
def test_json_comes_back_and_is_canonical(value: object) -> None:
    document = encode_json(value)
    assert document.endswith(b"\n") and not document.endswith(b"\n\n")
    found = decode_json(document, "s")
    assert found == value
    assert canonical_json(found) == canonical_json(value) and encode_json(found) == document


def test_the_key_is_the_sha256_of_the_canonical_text() -> None:
    identity = {"stage": "evolve", "depth": 0.1, "seed": 2**63, "é": [1.0, -0.0, 1e-7, (True, None)]}
    text = '{"depth":0.1,"seed":9223372036854775808,"stage":"evolve","é":[1.0,-0.0,1e-07,[true,null]]}'
    assert canonical_json(identity).decode() == text
    # printf '%s' TEXT | sha256sum
    assert key_of(identity) == "e55a31d855056735c7e1295aed9794f965927e2c50472375cac49a4085649efb"


@pytest.mark.parametrize("value", [{"n": np.int64(1)}, {"a": [float("nan")]}, float("inf"), "\ud800"])
def test_what_json_has_no_exact_form_for_is_refused(value: object) -> None:
    for encode in (canonical_json, encode_json):
        with pytest.raises((TypeError, ValueError)):
            encode(value)


@pytest.mark.parametrize("text", ["", "{", "[1,]", "1 2", "9" * 5000, "\xff"])
def test_bad_json_is_refused_by_name(text: str) -> None:
    with pytest.raises(PuddleError, match=r"champion\.json: expected a JSON document"):
        decode_json(text.encode("latin-1"), "champion.json")


@pytest.mark.parametrize(
    ("text", "where"), [("NaN", ""), ('{"a": {"b": [1, -Infinity]}}', "a.b[1]: "), ("[[1e999]]", "[0][0]: ")]
)
def test_a_number_that_is_not_finite_is_refused_by_its_place(text: str, where: str) -> None:
    with pytest.raises(
        PuddleError, match=rf"^champion\.json: {re.escape(where)}expected a finite number, got (nan|-?inf)$"
    ):
        decode_json(text.encode(), "champion.json")
