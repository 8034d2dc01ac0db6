"""A study may die, or lose power, at any effect on the disk, and the next run still ends in the same bytes.

A process that dies leaves on the disk what it has written, and nothing else matters to the next one. So one run is
surveyed for the disks that every fault at every point would leave, and a real driver continues from each distinct disk.
"""

import shutil

import pytest
from crash_consistency_disk import survey, write_image
from quick_study import Record, tree

from pipeline.commands.gc import find_garbage
from pipeline.store.store import Store, StudyRecord

pytestmark = pytest.mark.timeout(1800)  # the machine may be busy

KINDS = ["die", "tear", "all", "contents", "names", "some"]
"""Faults: death before an effect, death half-way through a write, and power cuts that lose all unsynced data, contents
alone, names alone, or some of both at random."""

PARTS = {"science": (None, "transfer"), "analyses": ("transfer", "analyse"), "report": ("analyse", "report")}
"""Parts of the study: the last stage before it, and its own last stage."""


@pytest.mark.parametrize("part", PARTS)
def test_the_next_driver_continues_from_any_disk_that_a_fault_leaves(torture, tiny, new_folder, part):
    before, last = PARTS[part]
    kinds = KINDS if part == "science" or torture.large else ["die", "all"]
    for rng in torture.attempts(1, 20):  # each attempt loses other data at random
        top = new_folder()
        (top / "disk").mkdir()
        if before:
            tiny.drive(top / "disk" / "store", last=before)
        record = Record()
        with survey(top / "disk", kinds, int(rng.integers(2**32)), record.committed) as found:
            tiny.drive(top / "disk" / "store", last=last, record=record)
        assert sorted(record.computed) == sorted(record.committed) and len(found.effects) > 50
        n_torn = found.effects.count("write") if "tear" in kinds else 0
        assert found.n_faults == (len(kinds) - ("tear" in kinds)) * len(found.effects) + n_torn
        undisturbed = tree(top / "disk" / "store")
        for image, committed in zip(found.disks, found.committed, strict=True):
            left = new_folder() / "left"
            write_image(image, left)
            again = tiny.drive(left / "store", last=last)
            assert not set(again.computed) & set(committed)
            assert tree(left / "store") == undisturbed
            shutil.rmtree(left)


def keys_of(root) -> set[str]:
    """Return the keys of all items in a store."""
    store = Store.open(root, create=False)
    return {key for _, key in store.items()}


def collect_garbage(root) -> None:
    """Do what `puddle gc --remove` does."""
    store = Store.open(root, create=False)
    with store.lock_all():
        for item in find_garbage(store):
            store.discard(*item)


def test_a_gc_that_dies_leaves_an_intact_store(torture, tiny, new_folder):
    """Nothing is damaged in whatever is left; the next gc completes the removal, and a study can be run again."""
    root = new_folder() / "disk" / "store"
    root.parent.mkdir()
    tiny.drive(root, last="transfer")
    undisturbed, everything = tree(root), keys_of(root)
    store = Store.open(root, create=False)
    longer = store.read_study("tiny").settings
    shorter = {**longer, "evolution": {**longer["evolution"], "n_generations": 2}}
    store.write_study(StudyRecord("tiny", shorter, ()))  # it needs only the first work item of evolution
    half = root / "items" / "evolve" / "00" / ("0" * 64)
    half.mkdir(parents=True)
    (half / ".history.parquet.tmp").write_bytes(b"half")
    kinds = [kind for kind in KINDS if kind != "tear"] if torture.large else ["die", "all"]
    with survey(root.parent, kinds, int(torture.rng().integers(2**32))) as found:
        collect_garbage(root)
    collected, needed = tree(root), keys_of(root)
    assert {"unlink", "fsync"} <= set(found.effects)
    assert len(everything - needed) == 3 and not half.exists()
    for image in found.disks:
        left = new_folder() / "left"
        write_image(image, left)
        assert needed <= keys_of(left / "store")
        assert Store.open(left / "store", create=False).verify() == []
        shutil.copytree(left, other := new_folder() / "other")
        collect_garbage(left / "store")
        assert tree(left / "store") == collected
        gone = everything - keys_of(other / "store")
        assert set(tiny.drive(other / "store", last="transfer").computed) == gone
        assert tree(other / "store").items() >= undisturbed.items()
