"""The store refuses what is damaged, foreign or hostile: bits, files, folders, names, links."""

import subprocess
from pathlib import Path

import pytest
from mounted import mounted
from one_item import FILES, KEY, commit, item, tree

from pipeline.errors import DamagedArtifact, PuddleError
from pipeline.store.encoding import encode_document
from pipeline.store.store import Store


@pytest.mark.parametrize("name", ["history.parquet", "manifest.json"])
@pytest.mark.parametrize("damage", ["flip", "cut", "empty", "gone"])
def test_damage_is_found_named_and_mended_by_discarding(store: Store, name: str, damage: str) -> None:
    commit(store)
    undisturbed = tree(store.root)
    path = item(store) / name
    good = path.read_bytes()
    path.unlink()
    match damage:
        case "flip":
            path.write_bytes(b"R" + good[1:])
        case "cut":
            path.write_bytes(good[: len(good) // 2])
        case "empty":
            path.write_bytes(b"")
    if (name, damage) == ("manifest.json", "gone"):  # then it never happened
        assert store.manifest("evolve", KEY) is None and store.verify() == []
    else:
        (wrong,) = store.verify()
        assert str(path) in str(wrong)
        assert isinstance(wrong, DamagedArtifact) and (wrong.stage, wrong.key) == ("evolve", KEY)
        if damage != "flip":  # a study plans by manifests alone: work whose result is gone must not look done
            with pytest.raises(DamagedArtifact, match=str(path)):
                store.manifest("evolve", KEY)
        for _ in range(2):  # what is gone may be discarded as well
            store.discard("evolve", KEY)
        assert store.manifest("evolve", KEY) is None and not list(store.items())
    commit(store)
    assert tree(store.root) == undisturbed


def test_a_commit_replaces_a_damaged_item(store: Store) -> None:
    commit(store)
    undisturbed = tree(store.root)
    (item(store) / ".history.parquet.tmp").write_bytes(b"half of it")
    for name in ("state.safetensors", "manifest.json"):
        path = item(store) / name
        path.write_bytes(b"x" * len(path.read_bytes()))
        commit(store)
        assert tree(store.root) == undisturbed


def test_a_manifest_of_a_newer_puddle_is_neither_used_nor_lost(store: Store) -> None:
    commit(store)
    path = item(store) / "manifest.json"
    newer = encode_document({"all": "new"}, schema="puddle.manifest", version=2)
    path.write_bytes(newer)
    for use in (lambda: store.manifest("evolve", KEY), lambda: commit(store)):
        with pytest.raises(PuddleError, match=r"got version 2\. A newer puddle wrote it: upgrade puddle") as told:
            use()
        assert not isinstance(told.value, DamagedArtifact)
    assert path.read_bytes() == newer


def test_a_place_that_is_no_store_is_refused_and_left_alone(tmp_path: Path) -> None:
    with pytest.raises(PuddleError, match=r"expected a store .*found none"):
        Store.open(tmp_path / "nothing", create=False)
    assert not (tmp_path / "nothing").exists()
    home = tmp_path / "home"
    home.mkdir()
    for name in "abcd":
        (home / name).write_text(name)
    before = tree(tmp_path)
    with pytest.raises(PuddleError, match=r"found a, b, c and more\. Choose another folder"):
        Store.open(home, create=True)
    for place in (home / "a" / "store", home / "a" / "deep" / "store"):
        with pytest.raises(OSError, match=f"{home / 'a'}"):
            Store.open(place, create=True)
    assert tree(tmp_path) == before


def test_a_store_of_a_newer_puddle_or_a_damaged_one_is_refused(tmp_path: Path) -> None:
    store = Store.open(tmp_path / "store", create=True)
    path = store.root / "store.json"
    good = path.read_bytes()
    path.write_bytes(encode_document({}, schema="puddle.store", version=2))
    with pytest.raises(PuddleError, match=r"expected 'puddle\.store' version 1, got version 2\. A newer puddle"):
        Store.open(store.root, create=True)
    for bad in (good[:-3], b""):
        path.write_bytes(bad)
        with pytest.raises(DamagedArtifact, match=r"store\.json: expected a JSON document"):
            Store.open(store.root, create=True)
    path.write_text('{"schema": "somebody.else", "version": 1}')
    with pytest.raises(PuddleError, match=r"got 'somebody\.else'"):
        Store.open(store.root, create=False)


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


@pytest.mark.parametrize("name", ["", "..", "/etc", "a/b", "A", "-a", "a.b", "a\n", "é", "x" * 65])
def test_names_that_are_no_folders_are_refused(store: Store, name: str) -> None:
    before = tree(store.root)
    for use in (
        lambda: store.manifest(name, KEY),
        lambda: store.manifest("evolve", name),
        lambda: store.read_study(name),
        lambda: store.lock_study(name).__enter__(),
    ):
        with pytest.raises(PuddleError, match="expected"):
            use()
    assert tree(store.root) == before


def test_a_link_to_the_store_itself_is_the_users_choice(store: Store, tmp_path: Path) -> None:
    commit(store)
    (tmp_path / "link").symlink_to(store.root)
    assert Store.open(tmp_path / "link", create=True) == store
