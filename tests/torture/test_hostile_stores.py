"""Hostile stores: nothing outside the store is read, written or removed, and memory stays bounded.

A store may come from a stranger, who can seal documents and hash files as puddle does.
"""

import json
import shutil
from pathlib import Path

import pytest
from fork_server import tree
from memory import MEGABYTE, memory_below

from pipeline.cluster import session
from pipeline.commands.damage import find_damage
from pipeline.commands.garbage import Garbage, find_garbage, remove_garbage
from pipeline.errors import PuddleError
from pipeline.store.encoding import encode_sealed
from pipeline.store.store import STUDY_SCHEMA, Store, StudyRecord


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
