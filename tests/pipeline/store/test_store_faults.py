"""The store keeps what was committed, whole or not at all, whatever dies, fills up or fails at any of its effects."""

import contextlib
import errno
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from one_item import FILES, IDENTITY, KEY, commit, item, tree

from pipeline.errors import PuddleError
from pipeline.store import disk
from pipeline.store.encoding import key_of
from pipeline.store.store import Store, StudyItem, StudyRecord

EFFECTS = ("write", "fsync", "rename", "mkdir", "unlink", "rmdir")


class Death(BaseException):
    """The process is gone: no effect follows."""


class Seam:
    """Stands in for the six effects: counts them, and strikes at one and at all that follow, or at one alone."""

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
    """Whatever is left is no item any more, and `puddle gc` finds it."""
    seam = Seam(monkeypatch, Death, for_good=True)
    # of 3 files and the manifest each is unlinked and the folder synced; then the folder goes, and its parent is synced
    for call in range(2 * (len(FILES) + 1) + 2):
        store = Store.open(tmp_path / f"store{call}", create=True)
        commit(store)
        undisturbed = tree(store.root)
        seam.arm(call)
        with pytest.raises(Death):
            store.discard("evolve", KEY)
        seam.arm(None)
        assert list(store.keys("evolve")) == ([KEY] if call == 0 else [])
        assert list(store.keys("evolve", committed=False)) == ([KEY] if call > 0 and item(store).exists() else [])
        whole_or_absent(store.root, undisturbed)


def test_making_a_store_may_die_at_any_effect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seam = Seam(monkeypatch, Death, for_good=True)
    Store.open(tmp_path / "reference" / "deep", create=True)
    n_effects, undisturbed = seam.n_calls, tree(tmp_path / "reference" / "deep")
    assert n_effects == 2 * 2 + 4  # two folders, each made and its parent synced; store.json
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
    for call in range(4):
        store.write_study(StudyRecord("laptop", {"seed": 1}, old))
        seam.arm(call)
        with pytest.raises(Death):
            store.write_study(StudyRecord("laptop", {"seed": 1}, new))
        seam.arm(None)
        assert store.verify() == []
        seen.add(store.read_study("laptop").items[0].label)
        assert store.read_study("laptop").items[0].label == ("new" if call == 3 else "old")  # the rename is the third
    assert seen == {"old", "new"}


def test_a_killed_process_leaves_a_store_that_goes_on(tmp_path: Path) -> None:
    """As above with a real end: no finally, no destructor, the lock let go by the kernel alone."""
    code = (
        "import os, sys\n"
        "from pathlib import Path\n"
        "from pipeline.store import disk\n"
        "from pipeline.store.store import Store\n"
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


def test_nothing_changes_but_under_the_commit_lock(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """A temporary file's name is always the same: two at once would write into one."""
    lock = store.root / "commit.lock"
    lock.touch()
    taken = []

    def watch(effect: Callable[..., None]) -> Callable[..., None]:
        def watched(path: Path, *rest) -> None:
            descriptor = disk.try_lock(lock, only_ask=True)
            taken.append(descriptor is None)
            if descriptor is not None:
                os.close(descriptor)
            effect(path, *rest)

        return watched

    for name in EFFECTS:
        monkeypatch.setattr(disk, name, watch(getattr(disk, name)))
    changes = (
        lambda: commit(store),
        lambda: store.discard("evolve", KEY),
        lambda: store.write_study(StudyRecord("laptop", {"seed": 1}, ())),
        lambda: store.export("laptop", {"index.html": b"page"}),
    )
    for change in changes:
        taken.clear()
        change()
        assert taken and all(taken)


def test_whoever_removes_and_whoever_drives_refuse_one_another(store: Store) -> None:
    driven = pytest.raises(PuddleError, match=r"study laptop is driven by process .*; study paper is driven by")
    with store.lock_study("laptop"), store.lock_study("paper"), driven, store.lock_all():
        pass
    removing = pytest.raises(PuddleError, match=r"process \d+ on .* is removing items\. Wait until it ends")
    with store.lock_all(), removing, store.lock_study("paper"):
        pass
    with store.lock_all(), pytest.raises(PuddleError, match=f"{store.root} is in use"), store.lock_all():
        pass
    with store.lock_study("laptop"):
        pass


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (
            errno.ENOSPC,
            "No space left on device.*Committed results are safe.*Free some space and run the same command again",
        ),
        (errno.EDQUOT, "quota.*Committed results are safe.*Free some space"),
        (errno.EROFS, "Read-only file system.*Committed results are safe.*choose another folder"),
        (errno.EACCES, "Permission denied.*Committed results are safe.*choose another folder"),
        (errno.EIO, "Input/output error.*Committed results are safe.*Remove the cause"),
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
        with store.lock_all():
            pass
        subprocess.run(["mount", "-o", "remount,ro", str(tmp_path)], check=True)
        store = Store.open(tmp_path / "store", create=True)
        with store.lock_to_read():
            assert store.read(store.manifest("evolve", KEY), "log") == b""
        assert store.verify() == []
        other = {"stage": "evolve", "other": True}
        with pytest.raises(PuddleError, match=r"Read-only file system.*choose another folder"):
            store.commit("evolve", key_of(other), other, FILES, record={})
        with pytest.raises(PuddleError, match="Read-only file system"), store.lock_study("laptop"):
            raise AssertionError("locked a read-only disk")
        with pytest.raises(PuddleError, match="Read-only file system"):
            Store.open(tmp_path / "new", create=True)
