"""The store keeps what was committed, of items and studies, whoever works beside it."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from one_item import FILES, IDENTITY, KEY, RECORD, commit, item, tree

from pipeline.errors import DamagedArtifact, Irreproducible, PuddleError
from pipeline.store.encoding import digest, encode_document
from pipeline.store.provenance import _PACKAGES, environment
from pipeline.store.store import Store, StudyItem, StudyRecord


def test_a_committed_item_is_found_and_read_by_another_store_object(store: Store) -> None:
    assert store.manifest("evolve", KEY) is None
    committed = commit(store)
    found = Store.open(store.root, create=False).manifest("evolve", KEY)
    assert found == committed
    assert {name: store.read(found, name) for name in found.files} == FILES
    assert found.identity == IDENTITY and found.record == RECORD
    assert list(store.items()) == [("evolve", KEY)]
    assert store.verify() == []


def test_a_manifest_describes_the_item_and_where_it_was_made(store: Store, tmp_path: Path) -> None:
    """The digest is of names and contents alone."""
    committed = commit(store)
    made = json.loads((item(store) / "manifest.json").read_text())
    assert made["environment"]["numpy"] == np.__version__
    assert made["environment"]["cpu"] and made["environment"]["commit"]
    assert made["schema"] == "puddle.manifest" and made["files"]["log"] == {"n_bytes": 0, "sha256": digest(b"")}
    text = json.dumps([[name, digest(data)] for name, data in sorted(FILES.items())], separators=(",", ":"))
    assert committed.digest == digest(text.encode())
    other = Store.open(tmp_path / "other", create=True)
    again = other.commit("evolve", IDENTITY, dict(reversed(FILES.items())), record={"seconds": 99})
    assert again.digest == committed.digest


def test_versions_are_listed_in_one_order_as_the_page_shows_them() -> None:
    """The folder of packages lists them in an order that differs from process to process."""
    assert list(environment()) == [*_PACKAGES, "python", "system", "cpu", "commit"]


def test_a_result_computed_twice_must_be_equal(store: Store) -> None:
    first = commit(store)
    before = tree(store.root)
    assert store.commit("evolve", IDENTITY, FILES, record={"seconds": 7.0}) == first
    other = {**FILES, "log": b"other"}
    with pytest.raises(Irreproducible) as told:
        commit(store, other)
    new = digest(json.dumps([[n, digest(d)] for n, d in sorted(other.items())], separators=(",", ":")).encode())
    assert first.digest in str(told.value) and new in str(told.value) and "in log:" in str(told.value)
    assert tree(store.root) == before


def test_an_item_in_the_place_of_another_is_noticed(store: Store) -> None:
    commit(store)
    other = store.commit("evolve", {**IDENTITY, "version": 2}, FILES, record={})
    shutil.copytree(store.manifest_path("evolve", other.key).parent, item(store), dirs_exist_ok=True)
    with pytest.raises(DamagedArtifact, match=f"expected evolve {KEY}, got evolve {other.key}"):
        store.manifest("evolve", KEY)
    (found,) = store.verify()
    assert (found.stage, found.key) == ("evolve", KEY)


RACE = """
import sys
from pathlib import Path
from pipeline.store.encoding import key_of
from pipeline.store.store import Store
print("ready", flush=True)
sys.stdin.readline()
store = Store.open(Path(sys.argv[1]), create=True)
for n in range(60):
    identity = {"n": n}
    store.commit("evolve", identity, {"a": b"%d" % n * 999, "b": b"b"}, record={"by": sys.argv[2]})
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
    assert len(list(store.items())) == 60 and store.verify() == []
    assert not [name for name in tree(root) if name.endswith(".tmp")]


def test_a_study_record_comes_back(store: Store) -> None:
    assert store.read_study("laptop") is None and store.studies() == []
    items = [StudyItem("collect", "throws 0..99", KEY), StudyItem("evolve", "dry_land 9 m, trial 3", KEY)]
    store.write_study(StudyRecord("laptop", {"seed": 1, "grid": {"depths": (0.0, 9.0)}}, tuple(items)))
    record = store.read_study("laptop")
    assert record.items == tuple(items) and record.name == "laptop"
    assert record.settings == {"seed": 1, "grid": {"depths": [0.0, 9.0]}}
    assert store.studies() == ["laptop"]


def test_a_damaged_study_record_is_told(store: Store) -> None:
    store.write_study(StudyRecord("laptop", {"seed": 1}, ()))
    path = store.root / "studies" / "laptop" / "study.json"
    path.write_bytes(path.read_bytes()[:-9])
    (wrong,) = store.verify()
    assert str(path) in str(wrong) and "running the study again rewrites the file" in str(wrong)
    path.write_bytes(encode_document({"name": "laptop", "items": [3]}, schema="puddle.study", version=1))
    with pytest.raises(DamagedArtifact, match="expected a study's name, settings and items"):
        store.read_study("laptop")


DRIVER = """
import sys
from pathlib import Path
from pipeline.store.store import Store
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
        refused = pytest.raises(
            PuddleError, match=f"study laptop is driven by process {driver.pid} .*Wait until it ends"
        )
        with refused, store.lock_study("laptop"):
            raise AssertionError("two drivers")
        with store.lock_study("paper"):
            assert f"process {os.getpid()} " in store.driver_of("paper")
        assert commit(store)  # another study goes on beside it
        driver.kill()
    assert store.driver_of("laptop") is None
    with pytest.raises(ZeroDivisionError), store.lock_study("laptop"):
        assert f"process {os.getpid()} " in store.driver_of("laptop")
        raise ZeroDivisionError
    assert store.driver_of("laptop") is None


def test_whoever_removes_excludes_who_drives(store: Store) -> None:
    driven = pytest.raises(PuddleError, match=r"study laptop is driven by process .*; study paper is driven by")
    with store.lock_study("laptop"), store.lock_study("paper"), driven, store.lock_all():
        raise AssertionError("removed what is driven")
    removing = pytest.raises(PuddleError, match="another process of puddle remov")
    with store.lock_all():
        with removing, store.lock_all():
            raise AssertionError("removed twice")
        with pytest.raises(PuddleError, match="is removing items"), store.lock_study("paper"):
            raise AssertionError("used what is removed")


def test_a_report_takes_the_place_of_the_earlier_one(store: Store) -> None:
    folder = store.export("laptop", {"index.html": b"old", "robot.svg": b"<svg/>"})
    assert folder == store.root / "studies" / "laptop" / "report"
    (folder / "notes.txt").write_bytes(b"mine")
    store.export("laptop", {"index.html": b"new"})
    assert tree(folder) == {"index.html": b"new", "notes.txt": b"mine", ".files": b"index.html"}


def test_the_root_of_a_disk_may_be_a_store(tmp_path: Path) -> None:
    (tmp_path / "lost+found").mkdir()
    assert Store.open(tmp_path, create=True).root == tmp_path
