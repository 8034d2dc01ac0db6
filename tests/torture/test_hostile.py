"""Hostile files: nothing in them is executed, and memory stays bounded.

A settings file or a design may come from a stranger, who can seal documents and hash files as puddle does.
"""

import contextlib
import copy
import io
import pickle
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, seed, settings
from hypothesis import strategies as st
from memory import MEGABYTE, memory_below

from pipeline.commands.damage import find_damage
from pipeline.config.loading import load
from pipeline.config.settings import Settings
from pipeline.errors import Irreproducible, PuddleError
from pipeline.store.design_file import read_design
from pipeline.store.encoding import decode_arrays, decode_table, encode_sealed, encode_table, key_of
from pipeline.store.manifest import MANIFEST_SCHEMA, MAX_FILE_BYTES, Manifest, decode_manifest, refuse_other_content
from pipeline.store.store import Store

ROOT = Path(__file__).parents[2]


@pytest.fixture
def sentinel(tmp_path):
    """A file that appears if hostile input is executed."""
    path = tmp_path / "executed"
    yield path
    assert not path.exists()


class Bomb:
    """A pickle that runs a command."""

    def __init__(self, sentinel: Path) -> None:
        self.sentinel = sentinel

    def __reduce__(self):
        return (open, (str(self.sentinel), "w"))


# -- texts -----------------------------------------------------------------------------------------------------------

LINES = [
    "name: x",
    "name: ../../etc",
    "name: /etc/passwd",
    "name: 'a\\0b'",
    f"name: {'x' * 100_000}",
    "seed: 1",
    "seed: 1",
    "evolution: {n_generations: 1e999}",
    "evolution: {n_generations: !!int 3}",
    "grid: {depths: [.inf, -.inf, .nan]}",
    "run: !!python/object/apply:os.system ['touch SENTINEL']",
    "run: !!python/name:os.system",
    "? [1, 2]\n: 3",
    "run: !!python/object/new:subprocess.Popen [['touch', 'SENTINEL']]",
    "a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]",
    "<<: {seed: 3}",
    "grid: {depths: " + "[" * 5000,
    "{" * 5000,
    "seed: " + "9" * 100_000,
    "--- \n---",
    "%YAML 9.9",
    "\x00",
    "\ufeff",
    "\ud7ff",
    "\t- x",
    "key: |\n  " + "y" * 1000,
    "seed: 0x1F",
    "name: yes",
    "- " * 2000,
    "'" * 999,
    "throws: {n_throws: 99999999999999999999}",
    "__class__: {__init__: 1}",
    "work: {engine: __import__('os')}",
]


def test_settings_of_hostile_lines(torture, tmp_path, sentinel):
    path, n_read = tmp_path / "hostile.yaml", 0
    lines = [line.replace("SENTINEL", str(sentinel)) for line in LINES]
    with memory_below(300 * MEGABYTE):
        for rng in torture.attempts(100, 20_000):
            chosen = rng.choice(len(lines), size=int(rng.integers(1, 6)))
            path.write_text("\n".join(lines[index] for index in chosen), errors="surrogatepass")
            try:
                load(Settings, path)
                n_read += 1
            except PuddleError as error:
                assert str(path) in str(error) and len(str(error)) < 20_000
    torture.note(f"{n_read:,} were harmless; the rest were refused by file and line")


@pytest.mark.parametrize("kind", ["deep", "long", "number", "twice", "pickle", "endless"])
def test_a_hostile_design_is_refused_by_name(kind, tmp_path, sentinel):
    path = tmp_path / "design.json"
    match kind:
        case "deep":
            path.write_text('{"a": ' + "[" * 500_000)
        case "long":
            with path.open("wb") as file:
                file.truncate(8 * 2**30)
        case "number":
            path.write_text((ROOT / "docs/design.json").read_text().replace("0.26311942665854743", "9" * 10_000))
        case "twice":
            path.write_text((ROOT / "docs/design.json").read_text().replace('"version"', '"frequency": 1, "version"'))
        case "pickle":
            path.write_bytes(pickle.dumps(Bomb(sentinel)))
            sentinel.unlink(missing_ok=True)
        case "endless":
            path = Path("/dev/zero")
    with memory_below(300 * MEGABYTE), pytest.raises(PuddleError, match=str(path)):
        read_design(path)


JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=20)
    | st.sampled_from(["..", "/etc/passwd", "a/../b", "x\0y", "é" * 300, "0" * 64, -1, 5.0, True, 2**44, 10**400]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)


IDENTITY = {"stage": "evolve", "version": 1}
FIELDS = [
    ("stage",),
    ("key",),
    ("identity",),
    ("files",),
    ("files", "a.json"),
    ("files", "a.json", "sha256"),
    ("files", "a.json", "bytes"),
    ("digest",),
    ("environment",),
    ("record",),
    ("record", "seconds"),
]


def manifest_body() -> dict:
    """Return the body of a valid manifest."""
    entry = {"sha256": "0" * 64, "bytes": 5}
    made = {"cpu": "one", "commit": "none"}
    return {
        "stage": "evolve",
        "key": key_of(IDENTITY),
        "identity": IDENTITY,
        "files": {"a.json": entry},
        "digest": "",
        "environment": made,
        "record": {"seconds": 1.0},
    }


def decoded(body: dict) -> Manifest:
    data = encode_sealed(body, schema=MANIFEST_SCHEMA, version=1)
    return decode_manifest(data, stage="evolve", key=key_of(IDENTITY), source="it")


def test_a_hostile_manifest_with_a_valid_seal(torture):
    """One field at a time is hostile: it is refused, or what is read has valid types and bounds."""
    n_manifests, n_read, n_refused = 100, Counter(), Counter()
    whole = decoded(manifest_body())

    @settings(max_examples=n_manifests, database=None)
    @given(field=st.sampled_from(FIELDS), hostile=JSON)
    def check(field, hostile):
        body = copy.deepcopy(manifest_body())
        *above, last = field
        group = body
        for name in above:
            group = group[name]
        group[last] = hostile
        try:
            manifest = decoded(body)
        except PuddleError as error:
            assert str(error).startswith("it: ")
            n_refused[field] += 1
            return
        n_read[field] += 1
        assert (manifest.stage, manifest.key, manifest.identity) == ("evolve", key_of(IDENTITY), IDENTITY)
        assert manifest.files and set(manifest.files) <= {"a.json", "0" * 64} and manifest.digest
        for entry in manifest.files.values():
            assert re.fullmatch("[0-9a-f]{64}", entry.sha256)
            assert type(entry.n_bytes) is int and 0 <= entry.n_bytes <= MAX_FILE_BYTES
        assert 0 <= float(manifest.record.get("seconds", 0.0)) < float("inf")
        with contextlib.suppress(Irreproducible):
            refuse_other_content(manifest, whole)

    for rng in torture.attempts(3, 100):
        seed(int(rng.integers(2**32)))(check)()
    assert set(n_refused) >= set(FIELDS) - {("digest",)} and n_read[("digest",)]  # which is not read
    torture.note(f"{n_refused.total():,} manifests refused by name, {n_read.total():,} read, which are harmless")


@pytest.mark.parametrize("n_bytes", [5.0, 2**27, 2**44])
def test_files_as_long_as_a_manifest_says_do_not_fill_the_memory(n_bytes, new_folder):
    """Sparse files take no room. Files are hashed in chunks, and one that is too long is not hashed at all."""
    store = Store.open(new_folder() / "store", create=True)
    key = store.commit("evolve", key_of(IDENTITY), IDENTITY, {"a.json": b"hello"}, record={}).key
    path = store.manifest_path("evolve", key)
    body = manifest_body()
    body["files"]["a.json"]["bytes"] = n_bytes
    path.write_bytes(encode_sealed(body, schema=MANIFEST_SCHEMA, version=1))
    with (path.parent / "a.json").open("wb") as file:
        file.truncate(min(int(n_bytes), 2**40))
    with memory_below(32 * MEGABYTE):
        (wrong,) = find_damage(store)
    assert str(path if n_bytes != 2**27 else path.parent / "a.json") in str(wrong)


# -- formats ---------------------------------------------------------------------------------------------------------

FUZZ = """
import sys, resource
import numpy as np
from pipeline.store.encoding import decode_arrays, decode_table, encode_arrays, encode_table
from pipeline.errors import PuddleError
resource.setrlimit(resource.RLIMIT_AS, (6 * 2**30,) * 2)
seed, n = map(int, sys.argv[1:])
rng = np.random.default_rng(seed)
x = rng.normal(size=(200, 3))
columns = {"x": x, "n": np.arange(200), "word": np.array(["a", "bc"] * 100)}
formats = [
    (encode_table(columns, schema="t", version=1, producer=""), decode_table),
    (encode_arrays({"w": x, "b": x[0]}, schema="t", version=1, producer=""), decode_arrays),
]
n_refused = 0
for _ in range(n):
    good, decode = formats[rng.integers(2)]
    bad = bytearray(good)
    for _ in range(rng.integers(1, 4)):
        near_an_end = rng.choice([rng.integers(16), len(bad) - 1 - rng.integers(600)])
        where = rng.integers(len(bad)) if rng.random() < 0.5 else near_an_end
        bad[where : where + rng.integers(1, 9)] = rng.choice([b"\\xff" * 8, b"\\x7f" * 4, b"\\0" * 8, rng.bytes(4)])
    try:
        decode(bytes(bad), schema="t", version=1, source="it")
    except PuddleError as error:
        assert str(error).startswith("it")
        n_refused += 1
(peak,) = (line for line in open("/proc/self/status") if line.startswith("VmHWM"))  # ru_maxrss has the parent's
print(n_refused, peak.split()[1])
"""


def test_headers_and_pages_that_lie(torture):
    """In a process of its own, since a decoder that crashes would end the tests too."""
    n, n_refused, peak = 0, 0, 0
    for rng in torture.attempts(1, 20):
        done = subprocess.run(
            [sys.executable, "-c", FUZZ, str(rng.integers(2**32)), "2000"], cwd=ROOT, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr[-2000:]
        refused, kilobytes = map(int, done.stdout.split())
        n, n_refused, peak = n + 2000, n_refused + refused, max(peak, kilobytes)
        assert kilobytes < 2 * 2**20
    torture.note(f"{n_refused:,} of {n:,} files refused, the others read as before; at most {peak / 1e3:.0f} MB")


def test_a_table_that_would_fill_the_memory(tmp_path):
    """One or two megabytes decompress to more than 2 GB of zeros."""
    honest = encode_table({"x": np.zeros(4)}, schema="t", version=1, producer="")
    sink = io.BytesIO()
    zeros = pa.table({"x": np.zeros(2**24)}, schema=pq.read_schema(io.BytesIO(honest)))
    with pq.ParquetWriter(sink, zeros.schema, compression="zstd") as writer:
        for _ in range(17):
            writer.write_table(zeros)
    assert len(sink.getvalue()) < 2 * MEGABYTE
    with memory_below(300 * MEGABYTE), pytest.raises(PuddleError, match=r"it: .*bytes in memory, got 2281701376"):
        decode_table(sink.getvalue(), schema="t", version=1, source="it")


def test_a_pickle_is_not_opened(sentinel):
    bomb = pickle.dumps(Bomb(sentinel))
    for decode in (decode_table, decode_arrays):
        with pytest.raises(PuddleError, match=r"^it: expected"):
            decode(bomb, schema="t", version=1, source="it")


def test_an_identity_that_is_not_its_keys():
    identity = {"stage": "evolve"}
    body = {"stage": "evolve", "key": "0" * 64, "identity": identity, "files": {"a": {"sha256": "0" * 64, "bytes": 0}}}
    data = encode_sealed({**body, "environment": {}, "record": {}}, schema=MANIFEST_SCHEMA, version=1)
    assert key_of(identity) != "0" * 64
    with pytest.raises(PuddleError, match="expected evolve 0000"):
        decode_manifest(data, stage="evolve", key="0" * 64, source="it")
