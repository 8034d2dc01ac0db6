"""The store keeps what was committed where an effect on the disk fails. See also tests/torture/test_crash_points.py."""

import errno
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from mounted import mounted
from one_item import FILES, KEY, commit

from pipeline.store import disk
from pipeline.store.encoding import key_of
from pipeline.store.store import Store

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


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EIO])
def test_a_failing_disk_is_named_and_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    failing = Failing(monkeypatch, number)
    store = Store.open(tmp_path / "store", create=True)
    earlier = {"stage": "collect"}
    store.commit("collect", key_of(earlier), earlier, {"throws.parquet": b"kept"}, record={})
    for call in range(3 * 2 + 4 * 4):  # 3 folders are made and synced; 4 files are written, synced, renamed and synced
        shutil.rmtree(store.root / "items" / "evolve", ignore_errors=True)
        failing.left = call
        with pytest.raises(OSError, match=os.strerror(number)):
            commit(store)
        assert store.verify() == []
        assert store.read(store.manifest("collect", key_of(earlier)), "throws.parquet") == b"kept"
    commit(store)
    assert store.verify() == []


def test_a_read_only_disk_is_read(tmp_path: Path) -> None:
    with mounted(tmp_path, "size=1m"):
        store = Store.open(tmp_path / "store", create=True)
        commit(store)
        with store.lock_all():
            pass
        subprocess.run(["mount", "-o", "remount,ro", str(tmp_path)], check=True)
        store = Store.open(tmp_path / "store", create=True)
        assert store.read(store.manifest("evolve", KEY), "log") == b""
        assert store.verify() == []
        other = {"stage": "evolve", "other": True}
        with pytest.raises(OSError, match="Read-only file system"):
            store.commit("evolve", key_of(other), other, FILES, record={})
        with pytest.raises(OSError, match="Read-only file system"), store.lock_study("laptop"):
            raise AssertionError("locked a read-only disk")
        with pytest.raises(OSError, match="Read-only file system"):
            Store.open(tmp_path / "new", create=True)
