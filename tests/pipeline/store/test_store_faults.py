"""The store keeps what was committed, whole or not at all, whatever dies, fills up or fails at any of its effects."""

import contextlib
import errno
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from one_item import FILES, IDENTITY, KEY, commit, item, tree

from pipeline.errors import PuddleError
from pipeline.store import disk
from pipeline.store.encoding import key_of
from pipeline.store.store import Store, StudyRecord

EFFECTS = ("write", "fsync", "rename", "mkdir", "unlink", "rmdir")


class Failing:
    """Stands in for the six effects; one call fails, and half of what it was to write is there."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
        self.left, self._number = -1, number
        for name in EFFECTS:
            monkeypatch.setattr(disk, name, self._guard(name, getattr(disk, name)))

    def _guard(self, name: str, effect: Callable[..., None]) -> Callable[..., None]:
        def guarded(path: Path, *rest) -> None:
            self.left -= 1
            if self.left != -1:
                effect(path, *rest)
                return
            if name == "write":
                effect(path, rest[0][: len(rest[0]) // 2])
            raise OSError(self._number, os.strerror(self._number))

        return guarded


def test_a_killed_process_leaves_a_store_that_goes_on(tmp_path: Path) -> None:
    """No finally, no destructor, the lock let go by the kernel alone. See also tests/torture/test_crash_points.py."""
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
    survivor = Store.open(root, create=False)
    assert survivor.manifest("evolve", KEY) is None and survivor.verify() == []
    reference = Store.open(tmp_path / "reference", create=True)
    commit(reference)
    commit(survivor)
    assert tree(root) == tree(reference.root)


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
    failing = Failing(monkeypatch, number)
    store = Store.open(tmp_path / "store", create=True)
    earlier = {"stage": "collect"}
    store.commit("collect", key_of(earlier), earlier, {"throws.parquet": b"kept"}, record={})
    for call in range(3 * 2 + 4 * 4):  # 3 folders are made and synced; 4 files are written, synced, renamed and synced
        shutil.rmtree(store.root / "items" / "evolve", ignore_errors=True)
        failing.left = call
        with pytest.raises(PuddleError, match=f"{store.root}.*{said}"):
            commit(store)
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
