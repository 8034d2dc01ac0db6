"""The store on a read-only disk. See also tests/torture: a death at every effect on the disk, and disks that fill."""

import subprocess
from pathlib import Path

import pytest
from mounted import mounted
from one_item import FILES, KEY, commit

from pipeline.store.store import Store


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
            store.commit("evolve", other, FILES, record={})
        with pytest.raises(OSError, match="Read-only file system"), store.lock_study("laptop"):
            raise AssertionError("locked a read-only disk")
        with pytest.raises(OSError, match="Read-only file system"):
            Store.open(tmp_path / "new", create=True)
