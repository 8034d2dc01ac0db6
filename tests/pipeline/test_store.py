"""The store keeps what was committed, whole or not at all, whatever dies, fills up, runs beside it or is damaged."""

import contextlib
import errno
import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from pipeline import disk
from pipeline.artifacts import digest, encode_sealed, key_of
from pipeline.errors import DamagedArtifact, Irreproducible, PuddleError
from pipeline.store import Store, StudyItem

IDENTITY = {"stage": "evolve", "version": 1, "spec": {"depth": 0.5}, "inputs": {}}
KEY = key_of(IDENTITY)
FILES = {"history.parquet": b"rows" * 100, "state.safetensors": b"\0\1\2" * 50, "log": b""}
RECORD = {"seconds": 1.25}
EFFECTS = ("write", "fsync", "rename", "mkdir", "unlink")


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store.open(tmp_path / "store", create=True)


def commit(store: Store, files: dict[str, bytes] = FILES):
    return store.commit("evolve", KEY, IDENTITY, files, record=RECORD)


def item(store: Store) -> Path:
    return store.root / "items" / "evolve" / KEY[:2] / KEY


def tree(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


# -- what it is for --------------------------------------------------------------------------------------------------


def test_a_committed_item_is_found_and_read_by_another_store_object(store: Store) -> None:
    assert store.manifest("evolve", KEY) is None
    committed = commit(store)
    found = Store.open(store.root, create=False).manifest("evolve", KEY)
    assert found == committed
    assert {name: store.read(found, name) for name in found.files} == FILES
    assert found.identity == IDENTITY and found.record == RECORD
    assert list(store.keys("evolve")) == [KEY] and store.stages() == ["evolve"]
    assert store.verify() == []


def test_the_digest_is_of_names_and_contents_only(store: Store, tmp_path: Path) -> None:
    other = Store.open(tmp_path / "other", create=True)
    again = other.commit("evolve", KEY, IDENTITY, dict(reversed(FILES.items())), record={"seconds": 99})
    assert again.digest == commit(store).digest
    text = json.dumps([[name, digest(data)] for name, data in sorted(FILES.items())], separators=(",", ":"))
    assert again.digest == digest(text.encode())
    third = {**IDENTITY, "version": 2}
    assert store.commit("evolve", key_of(third), third, {**FILES, "log": b"x"}, record={}).digest != again.digest


def test_a_manifest_says_where_the_item_was_made(store: Store) -> None:
    made = json.loads((item(store) / "manifest.json").read_text()) if commit(store) else {}
    assert made["environment"]["numpy"] == np.__version__
    assert made["environment"]["python"] == sys.version.split()[0]
    assert made["environment"]["cpu"] and made["environment"]["commit"]
    assert made["schema"] == "puddle.manifest" and made["digest"] and made["files"]["log"] == {
        "bytes": 0, "sha256": digest(b"")
    }  # fmt: skip


def test_a_result_computed_twice_must_be_equal(store: Store) -> None:
    first = commit(store)
    before = tree(store.root)
    assert store.commit("evolve", KEY, IDENTITY, FILES, record={"seconds": 7.0}) == first
    other = {**FILES, "log": b"other"}
    with pytest.raises(Irreproducible) as told:
        commit(store, other)
    new = digest(json.dumps([[n, digest(d)] for n, d in sorted(other.items())], separators=(",", ":")).encode())
    assert first.digest in str(told.value) and new in str(told.value) and "in log:" in str(told.value)
    assert tree(store.root) == before


def test_a_discarded_item_is_computed_again_to_the_same_bytes(store: Store) -> None:
    commit(store)
    before = tree(store.root)
    store.discard("evolve", KEY)
    assert store.manifest("evolve", KEY) is None and list(store.keys("evolve")) == []
    store.discard("evolve", KEY)
    commit(store)
    assert tree(store.root) == before


def test_size_is_that_of_all_files(store: Store) -> None:
    commit(store)
    assert store.size_bytes() == sum(len(data) for data in tree(store.root).values())


def test_a_key_that_is_not_of_its_identity_and_bad_file_names_are_defects(store: Store) -> None:
    with pytest.raises(ValueError, match=f"expected the key of its identity, {KEY}"):
        store.commit("evolve", "0" * 64, IDENTITY, FILES, record={})
    for name in ("manifest.json", "../x", "a/b", ".hidden", "a.b.c", "A.json", "x\n", "", "x" * 65):
        with pytest.raises(ValueError, match="expected file names like"):
            store.commit("evolve", KEY, IDENTITY, {name: b""}, record={})
    with pytest.raises(ValueError, match="expected file names like"):
        store.commit("evolve", KEY, IDENTITY, {}, record={})


# -- dying and failing at any effect ---------------------------------------------------------------------------------


class Death(BaseException):
    """The process is gone: no effect follows."""


class Seam:
    """Stands in for the five effects: counts them, and strikes at one and at all that follow, or at one alone."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, strike: Callable[[], BaseException], *, for_good: bool) -> None:
        self.n_calls, self.strike_at = 0, None
        self._strike, self._for_good = strike, for_good
        for name in EFFECTS:
            monkeypatch.setattr(disk, name, self._guard(name, getattr(disk, name)))

    def _guard(self, name: str, effect: Callable[..., None]) -> Callable[..., None]:
        def guarded(path: Path, *rest) -> None:
            call, self.n_calls = self.n_calls, self.n_calls + 1
            hit = call == self.strike_at
            if not hit and not (self._for_good and self.strike_at is not None and call > self.strike_at):
                effect(path, *rest)
                return
            if hit and name == "write":
                effect(path, rest[0][: len(rest[0]) // 2])  # half of it is there
            raise self._strike()

        return guarded

    def arm(self, call: int | None) -> None:
        self.n_calls, self.strike_at = 0, call


def whole_or_absent(root: Path, undisturbed: dict[str, bytes]) -> None:
    """Check that a survivor sees either no item or all of it."""
    survivor = Store.open(root, create=False)
    manifest = survivor.manifest("evolve", KEY)
    assert survivor.verify() == []
    if manifest is not None:
        assert {name: survivor.read(manifest, name) for name in manifest.files} == FILES
    commit(survivor)
    assert tree(root) == undisturbed


def test_a_commit_may_die_at_any_effect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seam = Seam(monkeypatch, Death, for_good=True)
    reference = Store.open(tmp_path / "reference", create=True)
    seam.arm(None)
    commit(reference)
    n_effects, undisturbed = seam.n_calls, tree(reference.root)
    # 4 folders, each made and its parent synced; for 3 files and the manifest: write, sync, rename, sync the folder
    assert n_effects == 4 * 2 + 4 * 4
    for call in range(n_effects):
        store = Store.open(tmp_path / f"store{call}", create=True)
        seam.arm(call)
        with pytest.raises(Death):
            commit(store)
        seam.arm(None)
        whole_or_absent(store.root, undisturbed)


def test_a_discard_may_die_at_any_effect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seam = Seam(monkeypatch, Death, for_good=True)
    for call in range(2 * (len(FILES) + 1)):
        store = Store.open(tmp_path / f"store{call}", create=True)
        commit(store)
        undisturbed = tree(store.root)
        seam.arm(call)
        with pytest.raises(Death):
            store.discard("evolve", KEY)
        seam.arm(None)
        whole_or_absent(store.root, undisturbed)


def test_making_a_store_may_die_at_any_effect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seam = Seam(monkeypatch, Death, for_good=True)
    Store.open(tmp_path / "reference" / "deep", create=True)
    n_effects, undisturbed = seam.n_calls, tree(tmp_path / "reference" / "deep")
    assert n_effects == 1 + 2 * 2 + 4  # the folder that was there is synced first
    for call in range(n_effects):
        root = tmp_path / f"store{call}" / "deep"
        seam.arm(call)
        with pytest.raises(Death):
            Store.open(root, create=True)
        seam.arm(None)
        Store.open(root, create=True)
        assert tree(root) == undisturbed


def test_a_study_record_is_the_old_or_the_new_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seam = Seam(monkeypatch, Death, for_good=True)
    old, new = [StudyItem("evolve", "old", KEY)], [StudyItem("evolve", "new", KEY)]
    store = Store.open(tmp_path / "store", create=True)
    seen = set()
    for call in range(5):
        store.write_study("laptop", {"seed": 1}, old)
        seam.arm(call)
        with pytest.raises(Death):
            store.write_study("laptop", {"seed": 1}, new)
        seam.arm(None)
        seen.add(store.read_study("laptop").items[0].label)
        assert store.read_study("laptop").items[0].label == ("new" if call == 4 else "old")  # the rename is the fourth
    assert seen == {"old", "new"}


def test_a_killed_process_leaves_a_store_that_goes_on(tmp_path: Path) -> None:
    """As above with a real end: no finally, no destructor, the lock let go by the kernel alone."""
    code = (
        "import os, sys\n"
        "from pathlib import Path\n"
        "from pipeline import disk\n"
        "from pipeline.store import Store\n"
        f"identity, key, files = {IDENTITY!r}, {KEY!r}, {FILES!r}\n"
        "store = Store.open(Path(sys.argv[1]), create=True)\n"
        "rename = disk.rename\n"
        "def dying(path, target):\n"
        "    if target.name == 'manifest.json': os.kill(os.getpid(), 9)\n"
        "    rename(path, target)\n"
        "disk.rename = dying\n"
        "store.commit('evolve', key, identity, files, record={'seconds': 1.25})\n"
    )
    root = tmp_path / "store"
    assert subprocess.run([sys.executable, "-c", code, str(root)]).returncode == -9
    assert (item(Store(root)) / ".manifest.json.tmp").exists()
    reference = Store.open(tmp_path / "reference", create=True)
    commit(reference)
    whole_or_absent(root, tree(reference.root))


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (errno.ENOSPC, "No space left on device.*kept before is safe.*Free some space and give the same command again"),
        (errno.EDQUOT, "quota.*kept before is safe.*Free some space"),
        (errno.EROFS, "Read-only file system.*kept before is safe.*choose another place"),
        (errno.EACCES, "Permission denied.*kept before is safe.*choose another place"),
        (errno.EIO, "Input/output error.*kept before is safe.*Mend the cause"),
    ],
)
def test_a_failing_disk_is_explained_and_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, said: str
) -> None:
    seam = Seam(monkeypatch, lambda: OSError(number, os.strerror(number)), for_good=False)
    store = Store.open(tmp_path / "store", create=True)
    earlier = {"stage": "collect"}
    store.commit("collect", key_of(earlier), earlier, {"throws.parquet": b"kept"}, record={})
    for call in range(16):  # of a commit into a folder that the first of them leaves behind
        store.discard("evolve", KEY)
        disk.make_folders(store.root, item(store))
        seam.arm(call)
        with pytest.raises(PuddleError, match=f"{store.root}.*{said}"):
            commit(store)
        seam.arm(None)
        assert store.verify() == []
        assert store.read(store.manifest("collect", key_of(earlier)), "throws.parquet") == b"kept"
    commit(store)
    assert store.verify() == []


@contextlib.contextmanager
def mounted(folder: Path, *options: str) -> Iterator[None]:
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", ",".join(options), "tmpfs", str(folder)], capture_output=True)
    if done.returncode:
        pytest.skip(f"may not mount a disk here: {done.stderr.decode().strip()}")
    try:
        yield
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk(tmp_path: Path) -> None:
    with mounted(tmp_path, "size=256k"):
        store = Store.open(tmp_path / "store", create=True)
        commit(store)
        big = {"stage": "evolve", "big": True}
        with pytest.raises(PuddleError, match="No space left on device"):
            store.commit("evolve", key_of(big), big, {"weights.safetensors": bytes(2**20)}, record={})
        assert store.manifest("evolve", key_of(big)) is None and store.verify() == []
        assert store.read(commit(store), "log") == b""


def test_a_read_only_disk_is_read(tmp_path: Path) -> None:
    with mounted(tmp_path, "size=1m"):
        store = Store.open(tmp_path / "store", create=True)
        commit(store)
        subprocess.run(["mount", "-o", "remount,ro", str(tmp_path)], check=True)
        store = Store.open(tmp_path / "store", create=True)
        assert store.read(store.manifest("evolve", KEY), "log") == b""
        assert store.verify() == []
        other = {"stage": "evolve", "other": True}
        with pytest.raises(PuddleError, match=r"Read-only file system.*choose another place"):
            store.commit("evolve", key_of(other), other, FILES, record={})
        with pytest.raises(PuddleError, match="Read-only file system"), store.lock_study("laptop"):
            raise AssertionError("locked a read-only disk")
        with pytest.raises(PuddleError, match="Read-only file system"):
            Store.open(tmp_path / "new", create=True)


# -- several processes -----------------------------------------------------------------------------------------------

RACE = """
import sys
from pathlib import Path
from pipeline.artifacts import key_of
from pipeline.store import Store
print("ready", flush=True)
sys.stdin.readline()
store = Store.open(Path(sys.argv[1]), create=True)
for n in range(60):
    identity = {"n": n}
    store.commit("evolve", key_of(identity), identity, {"a": b"%d" % n * 999, "b": b"b"}, record={"by": sys.argv[2]})
"""


def test_processes_that_make_and_fill_one_store_at_once(tmp_path: Path) -> None:
    root = tmp_path / "store"
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    racers = [subprocess.Popen([sys.executable, "-c", RACE, str(root), f"racer{i}"], **pipes) for i in range(3)]
    for racer in racers:
        assert racer.stdout.readline() == "ready\n"
    for racer in racers:
        racer.stdin.write("\n")
        racer.stdin.flush()
    assert [racer.wait(60) for racer in racers] == [0, 0, 0]
    for racer in racers:
        racer.stdin.close()
        racer.stdout.close()
    store = Store.open(root, create=False)
    assert len(list(store.keys("evolve"))) == 60 and store.verify() == []
    assert not [name for name in tree(root) if name.endswith(".tmp")]


def test_threads_that_differ_leave_one_result_whole(store: Store) -> None:
    outcomes: list[str] = []

    def work(n: int) -> None:
        try:
            outcomes.append(commit(store, {"a": b"%d" % n * 10_000, "b": b"%d" % n}).digest)
        except Irreproducible:
            outcomes.append("refused")

    threads = [threading.Thread(target=work, args=(n,)) for n in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert outcomes.count("refused") == 5
    assert store.verify() == [] and store.manifest("evolve", KEY).digest in outcomes


# -- studies ---------------------------------------------------------------------------------------------------------


def test_a_study_record_comes_back(store: Store) -> None:
    assert store.read_study("laptop") is None and store.studies() == []
    items = [StudyItem("collect", "throws 0..99", KEY), StudyItem("evolve", "dry_land 9 m, trial 3", KEY)]
    store.write_study("laptop", {"seed": 1, "grid": {"depths": (0.0, 9.0)}}, items)
    record = store.read_study("laptop")
    assert record.items == tuple(items) and record.name == "laptop"
    assert record.settings == {"seed": 1, "grid": {"depths": [0.0, 9.0]}}
    assert store.studies() == ["laptop"]


def test_a_damaged_study_record_is_told(store: Store) -> None:
    store.write_study("laptop", {"seed": 1}, [])
    path = store.root / "studies" / "laptop" / "study.json"
    path.write_bytes(path.read_bytes().replace(b'"seed": 1', b'"seed": 2'))
    (wrong,) = store.verify()
    assert str(path) in str(wrong) and "running the study again writes the file anew" in str(wrong)
    path.write_bytes(encode_sealed({"name": "laptop", "items": [3]}, schema="puddle.study", version=1))
    with pytest.raises(DamagedArtifact, match="expected a study's name, settings and items"):
        store.read_study("laptop")


DRIVER = """
import sys
from pathlib import Path
from pipeline.store import Store
with Store.open(Path(sys.argv[1]), create=False).lock_study("laptop"):
    print("driving", flush=True)
    sys.stdin.readline()
"""


def test_a_study_has_one_driver_which_is_named_to_a_second(store: Store) -> None:
    assert store.driver_of("laptop") is None
    command = [sys.executable, "-c", DRIVER, str(store.root)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as driver:
        assert driver.stdout.readline() == "driving\n"
        assert f"process {driver.pid} on {os.uname().nodename} since 20" in store.driver_of("laptop")
        refused = pytest.raises(PuddleError, match=f"study laptop is driven by process {driver.pid} .*Wait for its end")
        with refused, store.lock_study("laptop"):
            raise AssertionError("two drivers")
        with store.lock_study("paper"):
            assert f"process {os.getpid()} " in store.driver_of("paper")
        assert commit(store)  # another study goes on beside it
        driver.kill()
    assert store.driver_of("laptop") is None
    with store.lock_study("laptop"):
        assert f"process {os.getpid()} " in store.driver_of("laptop")


def test_asking_who_drives_is_never_in_the_drivers_way(store: Store) -> None:
    with store.lock_study("laptop"):
        pass
    stop = threading.Event()

    def ask() -> None:
        while not stop.is_set():
            store.driver_of("laptop")

    asker = threading.Thread(target=ask)
    asker.start()
    try:
        for _ in range(200):
            with store.lock_study("laptop"):
                pass
    finally:
        stop.set()
        asker.join()


def test_the_lock_is_let_go_when_the_study_fails(store: Store) -> None:
    with pytest.raises(ZeroDivisionError), store.lock_study("laptop"):
        raise ZeroDivisionError
    assert store.driver_of("laptop") is None


def test_reports_are_exported_in_place_of_earlier_ones(store: Store) -> None:
    store.export("laptop", {"index.html": b"old", "table.csv": b"1"})
    folder = store.export("laptop", {"index.html": b"new"})
    assert folder == store.export_path("laptop") == store.root / "studies" / "laptop" / "report"
    assert tree(folder) == {"index.html": b"new", "table.csv": b"1"}
    for name in ("../study.json", "a/b.html", ".x"):
        with pytest.raises(ValueError, match="expected file names like"):
            store.export("laptop", {name: b""})
