"""Hostile input: nothing in it is executed, nothing outside the store is touched, and memory stays bounded.

A store, a settings file or a design may come from a stranger, who can seal documents and hash files as puddle does.
"""

import contextlib
import copy
import io
import json
import pickle
import re
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from fork_server import tree
from hypothesis import given, seed, settings
from hypothesis import strategies as st

from pipeline.cluster import session
from pipeline.commands.damage import find_damage
from pipeline.commands.garbage import Garbage, find_garbage, remove_garbage
from pipeline.config.loading import load
from pipeline.config.settings import Settings
from pipeline.errors import Irreproducible, PuddleError
from pipeline.store.design_file import read_design
from pipeline.store.encoding import decode_arrays, decode_table, encode_sealed, encode_table, key_of
from pipeline.store.manifest import MANIFEST_SCHEMA, MAX_FILE_BYTES, Manifest, decode_manifest, refuse_other_content
from pipeline.store.store import STUDY_SCHEMA, Store, StudyRecord

ROOT = Path(__file__).parents[2]
MEGABYTE = 2**20


@contextlib.contextmanager
def memory_below(n_bytes: int):
    """Check that the memory of this process does not grow by more than this."""
    Path("/proc/self/clear_refs").write_text("5")  # resets the peak to the present use
    before = _peak()
    yield
    assert _peak() - before < n_bytes


def _peak() -> int:
    (line,) = (line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
    return 1024 * int(line.split()[1])


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


# -- stores ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pristine(fork_server, tmp_path_factory):
    root = tmp_path_factory.mktemp("pristine") / "store"
    fork_server.finish([root])
    return root


@pytest.fixture
def canary(pristine, new_folder):
    """A folder outside the store that must not change. Hostile names lead to it, and it contains what they could mean.

    ``../../../canary`` is this folder: from studies/ as a study, from items/ as a stage, and from a stage as an item.
    """
    folder = new_folder().parent / "canary"
    shutil.copytree(pristine / "studies" / "tiny", folder)
    for stage in (pristine / "items").iterdir():
        shutil.copytree(stage, folder, dirs_exist_ok=True)
    for name in ("manifest.json", "index.html", "file"):
        (folder / name).write_text(f"{name} of another user")

    def look() -> tuple[dict[str, str], dict[Path, int]]:
        return tree(folder), {path: path.stat().st_mtime_ns for path in (folder, *folder.rglob("*"))}

    before = look()
    yield folder
    assert look() == before


def test_links_in_a_store_are_refused_and_not_followed(torture, fork_server, pristine, new_folder, canary):
    n_refused = 0
    for rng in torture.attempts(12, 1000):
        root = new_folder() / "store"
        shutil.copytree(pristine, root)
        everything = sorted(root.rglob("*"))
        path = everything[int(rng.integers(len(everything)))]
        shutil.rmtree(path) if path.is_dir() else path.unlink()
        path.symlink_to(canary if rng.random() < 0.5 else canary / "file")
        answer = fork_server.drive(root, discard=bool(rng.random() < 0.3))
        refused = answer.get("error") or answer.get("traceback", "")
        assert "symbolic link" in refused and str(path) in refused, (path, answer)
        n_refused += 1
        shutil.rmtree(root)
    torture.note(f"{n_refused} links refused by name")


HOSTILE_NAMES = [
    "..",
    "../../../canary",
    "/etc",
    "a/b",
    "a\0b",
    "A",
    "",
    "x" * 300,
    ".",
    "~",
    "évil",
    "-rf",
    7,
    None,
    [],
    {},
]


def verify_and_collect(store: Store) -> list[str]:
    """Verify a store and collect its garbage; return the refusals."""
    said = [str(error) for error in find_damage(store)]
    try:
        with store.lock_all():
            remove_garbage(store, find_garbage(store))
    except PuddleError as error:
        said.append(str(error))
    return said


def test_a_hostile_study_record_with_a_valid_seal(
    torture, fork_server, pristine, new_folder, canary, monkeypatch, tmp_path
):
    monkeypatch.setattr(session, "SESSIONS_FOLDER", tmp_path)  # the garbage in /tmp belongs to other tests
    undisturbed, n_refused = tree(pristine), 0
    fields = ["name", "settings", "items", "stage", "label", "key", "folder"]
    for number, rng in enumerate(torture.attempts(14, 3000)):
        root = new_folder() / "store"
        shutil.copytree(pristine, root)
        path = root / "studies" / "tiny" / "study.json"
        whole = json.loads(path.read_text())
        body = {name: whole[name] for name in ("name", "settings", "items")}
        names = HOSTILE_NAMES if rng.random() < 0.5 else ["../../../canary", str(canary)]
        hostile = names[int(rng.integers(len(names)))]
        match field := fields[number % len(fields)]:
            case "name" | "settings" | "items":
                body[field] = hostile
            case "folder" if isinstance(hostile, str) and 0 < len(hostile) < 200 and not set(hostile) & set("/\0."):
                shutil.copytree(root / "studies" / "tiny", root / "studies" / hostile)
            case "stage" | "label" | "key":
                body["items"][0][["stage", "label", "key"].index(field)] = hostile
        path.write_bytes(encode_sealed(body, schema=STUDY_SCHEMA, version=1))
        harmless_types = {"label": (str,), "settings": (dict,), "items": (list, dict), "folder": (object,)}
        harmless = isinstance(hostile, harmless_types.get(field, ())) or (field == "items" and hostile == "")
        said = verify_and_collect(Store.open(root, create=False))
        answer = fork_server.drive(root, discard=True)
        assert answer["status"] == 0 and "error" not in answer and answer["wrong"] == [], answer
        assert answer["tree"].items() >= undisturbed.items()
        if not harmless:
            assert any(str(path) in line for line in said), (field, hostile)
            assert any(str(path) in line for line in answer["said"]), (field, hostile)
            n_refused += 1
        shutil.rmtree(root)
    assert n_refused
    torture.note(f"{n_refused} records refused by name and rewritten")


def test_no_hostile_name_is_written_or_removed(pristine, new_folder, canary):
    root = new_folder() / "store"
    shutil.copytree(pristine, root)
    store, undisturbed = Store.open(root, create=False), tree(root)
    key = next(store.keys("evolve"))
    names = {name for name in HOSTILE_NAMES if isinstance(name, str)} - {
        "/etc"
    }  # which must not be harmed if this test fails
    for name in sorted({*names, str(canary)}):
        for item in ((name, key), ("evolve", name)):
            for forget in (store.discard, store.remove, store.listing):
                with pytest.raises(PuddleError, match="expected"):
                    forget(*item)
            with pytest.raises(PuddleError, match="expected"):
                remove_garbage(store, Garbage(items=(item,), uncommitted=(), temporary=(), sessions=()))
        for write in (
            lambda name=name: store.write_study(StudyRecord(name, {}, ())),
            lambda name=name: store.export(name, {"index.html": b""}),
            lambda name=name: store.lock_study(name).__enter__(),
        ):
            with pytest.raises(PuddleError, match="expected 1 to 64 of a-z"):
                write()
        with pytest.raises(ValueError, match="expected file names"):
            store.export("tiny", {name: b""})
    assert tree(root) == undisturbed


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
print(n_refused, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
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


def test_a_manifest_as_long_as_a_disk(pristine, new_folder):
    root = new_folder() / "store"
    shutil.copytree(pristine, root)
    store = Store.open(root, create=False)
    stage = store.stages()[0]
    path = store._item(stage, next(store.keys(stage))) / "manifest.json"
    with path.open("wb") as file:
        file.truncate(20 * 2**30)  # a sparse file takes no room
    with memory_below(200 * MEGABYTE):
        assert any(str(path) in str(error) and "at most" in str(error) for error in find_damage(store))


def test_an_identity_that_is_not_its_keys(pristine):
    identity = {"stage": "evolve"}
    body = {"stage": "evolve", "key": "0" * 64, "identity": identity, "files": {"a": {"sha256": "0" * 64, "bytes": 0}}}
    data = encode_sealed({**body, "environment": {}, "record": {}}, schema=MANIFEST_SCHEMA, version=1)
    assert key_of(identity) != "0" * 64
    with pytest.raises(PuddleError, match="expected evolve 0000"):
        decode_manifest(data, stage="evolve", key="0" * 64, source="it")
