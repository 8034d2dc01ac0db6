"""A study may die at any effect on the disk, or lose its power there, and ends in the same bytes.

Every point is tried, always. A process that dies leaves on the disk what it has written, and nothing else matters to
the next one; so one run is surveyed for what every fault at every point of it would leave, and the next driver, a real
one, goes on from each different disk. That processes which do die leave what the survey says is tried too: at points
drawn by chance, at all of them with --torture.
"""

import hashlib
import shutil
from pathlib import Path

import pytest

from pipeline.commands.damage import damaged_items, find_damage
from pipeline.store.store import Store

pytestmark = pytest.mark.timeout(1800)  # a machine may have much else to do

KINDS = ["die", "tear", "all", "contents", "names", "some"]
"""Faults: death before an effect; half-way through a write; and what of that which was not synced goes with the power:
all of it; the contents alone, or the names alone; some of it, by chance."""


@pytest.fixture(scope="module")
def undisturbed(nursery, tmp_path_factory):
    """The study from beginning to end: its bytes, and the effects that made them."""
    (answer,) = nursery.finish([tmp_path_factory.mktemp("undisturbed") / "store"])
    assert len(answer["computed"]) == len(answer["committed"]) == 12 and len(answer["effects"]) > 150
    return answer


def survey(nursery, top: Path, kinds: list[str], seed: int) -> dict:
    """Run the study, and lay out in ``top/found`` every different disk that a fault of some kinds would leave."""
    for name in ("disk", "found"):
        (top / name).mkdir()
    (answer,) = nursery.finish(
        [top / "disk" / "store"], survey={"kinds": kinds, "seed": seed}, into=str(top / "found"), look=False
    )
    return answer


def resume(nursery, undisturbed, stores: list[Path], committed: list[list[str]]) -> None:
    """Check that the next driver brings the same bytes, and computes nothing again that was committed."""
    for begin in range(0, len(stores), 40):
        some = slice(begin, begin + 40)
        for after, kept in zip(nursery.finish(stores[some], look=False), committed[some], strict=True):
            assert not set(after["computed"]) & set(kept)
            assert after["tree"] == undisturbed["tree"]
        for store in stores[some]:
            shutil.rmtree(store.parent)


def test_the_next_driver_goes_on_from_any_disk_that_a_fault_leaves(torture, nursery, undisturbed, place):
    n_faults = n_disks = 0
    for rng in torture.attempts(1, 20):  # the chance of some being lost is another each time
        top = place()
        told = survey(nursery, top, KINDS, int(rng.integers(2**32)))
        assert told["tree"] == undisturbed["tree"]
        n_writes = told["effects"].count("write")
        faults = [tuple(fault) for disk in told["disks"] for fault in disk["faults"]]
        assert len(set(faults)) == len(faults) == (len(KINDS) - 1) * len(told["effects"]) + n_writes
        stores = [top / "found" / str(number) / "store" for number in range(len(told["disks"]))]
        resume(nursery, undisturbed, stores, [disk["committed"] for disk in told["disks"]])
        n_faults, n_disks = n_faults + len(faults), n_disks + len(stores)
        shutil.rmtree(top)
    n_effects = len(undisturbed["effects"])
    torture.note(f"{n_faults:,} faults, at 100 % of the {n_effects} effects, leave {n_disks:,} different disks")


@pytest.mark.share(2)
@pytest.mark.parametrize("kind", KINDS)
def test_a_process_that_ends_there_leaves_that_disk(torture, nursery, undisturbed, place, kind):
    """A real one, which is gone when the next begins; in small numbers at points drawn by chance."""
    effects = undisturbed["effects"]
    points = [at for at, effect in enumerate(effects) if kind != "tear" or effect == "write"]
    seed = int(torture.rng().integers(2**32))
    points = torture.rng().permutation(points).tolist()
    top = place()
    told = survey(nursery, top, [kind], seed)
    disk_of = {at: number for number, disk in enumerate(told["disks"]) for _, at in disk["faults"]}
    for at, _ in zip(points, torture.attempts(4, len(points)), strict=False):
        here = place()
        (here / "disk").mkdir()
        fault = {"kind": kind, "at": at}
        if kind not in ("die", "tear"):
            fault = {"kind": "power", "at": at, "loses": kind, "seed": seed + at, "image": str(here / "found")}
        before = nursery.drive(here / "disk" / "store", fault=fault)
        assert before["status"] == 9
        left = here / ("found" if fault["kind"] == "power" else "disk")
        assert contents(left) == contents(top / "found" / str(disk_of[at]))
        resume(nursery, undisturbed, [left / "store"], [before["committed"]])
        shutil.rmtree(here)


def contents(disk: Path) -> dict[str, str | None]:
    """Give the SHA-256 of every file on a disk, None for its folders; locks hold nothing."""
    return {
        str(path.relative_to(disk)): None if path.is_dir() else hashlib.sha256(path.read_bytes()).hexdigest()
        for path in disk.rglob("*")
        if path.suffix != ".lock"
    }


@pytest.mark.share(2)
def test_a_dead_driver_leaves_nothing_that_a_cut_takes_from_the_next(torture, nursery, undisturbed, place):
    """The first dies at any effect; the second ends the study; then the power goes, and every byte is there.

    All but one piece at most: the one that the first had put in its place, and not synced there, when it died. In
    small numbers the first dies before every fsync that follows upon a new folder, and at some other points.
    """
    effects = undisturbed["effects"]
    telling = [at for at in range(len(effects)) if effects[at - 1 : at] == ["mkdir"]]
    others = [at for at in torture.rng().permutation(len(effects)).tolist() if at not in telling]
    points = telling + others
    n_tried = 0
    for at, _ in zip(points, torture.attempts(len(telling) + 10, len(points)), strict=False):
        top = place()
        disk, account, image = top / "disk", str(top / "account"), str(top / "found")
        disk.mkdir()
        first = nursery.drive(disk / "store", fault={"kind": "die", "at": at, "leaves": account})
        fault = {"kind": "power", "at": "end", "takes": account, "loses": "all", "image": image}
        second = nursery.drive(disk / "store", fault=fault, look=False)
        assert (first["status"], second["status"]) == (9, 9)
        (answer,) = nursery.finish([top / "found" / "store"], look=False)
        assert len(answer["computed"]) <= 1
        assert answer["tree"] == undisturbed["tree"]
        shutil.rmtree(top)
        n_tried += 1
    assert n_tried >= len(telling) or torture.large


# -- what takes away -------------------------------------------------------------------------------------------------

TAKING = {"small": ["die", "all"], "large": [kind for kind in KINDS if kind != "tear"]}
"""Faults while something is taken away: no content is written then that could be torn."""


def disks_left(torture, nursery, top: Path, **command) -> list[Path]:
    """Take something away from the store ``top/disk/store``; return the stores that faults would leave of it."""
    (top / "found").mkdir()
    kinds = TAKING["large" if torture.large else "small"]
    (told,) = nursery.finish(
        [top / "disk" / "store"],
        drive=False,
        look=False,
        into=str(top / "found"),
        survey={"kinds": kinds, "seed": int(torture.rng().integers(2**32))},
        **command,
    )
    assert {"unlink", "fsync"} <= set(told["effects"])
    torture.note(f"{len(kinds) * len(told['effects'])} faults leave {len(told['disks'])} different disks")
    return [top / "found" / str(number) / "store" for number in range(len(told["disks"]))]


def keys_of(root: Path) -> set[str]:
    """Give the keys of all items that a store holds."""
    store = Store.open(root, create=False)
    return {key for stage in store.stages() for key in store.keys(stage)}


def study_on_a_disk(nursery, top: Path) -> Path:
    """Bring the study to its end in the store ``top/disk/store``."""
    root = top / "disk" / "store"
    root.parent.mkdir()
    nursery.finish([root], look=False)
    return root


def test_a_gc_that_dies_leaves_a_store_that_is_well(torture, nursery, undisturbed, place):
    """Whatever is left of what it removes: nothing is damaged, work that is asked for again goes on from it, and the
    next gc ends the job."""
    torture.times(1, 1)
    top = place()
    root = study_on_a_disk(nursery, top)
    everything = keys_of(root)
    store = Store.open(root, create=False)
    longer = store.read_study("tiny").settings
    shorter = {**longer, "evolution": {**longer["evolution"], "n_generations": 2}}
    store.write_study("tiny", shorter, ())  # it needs the first piece of what was evolved, and nothing after it
    half = root / "items" / "evolve" / "00" / ("0" * 64)
    half.mkdir(parents=True)
    for path in (half / ".history.parquet.tmp", store.study_path("tiny") / ".study.json.tmp"):
        path.write_bytes(b"half")
    stores = disks_left(torture, nursery, top, collect=True)
    collected, needed = contents(root), keys_of(root)
    assert needed and len(everything - needed) > 3 and not half.exists()
    left = [keys_of(store) for store in stores]
    assert {len(keys) for keys in left} == set(range(len(needed), len(everything) + 1))
    for store, keys in zip(stores, left, strict=True):
        assert needed <= keys
        assert find_damage(Store.open(store, create=False)) == []
        shutil.copytree(store, store.with_name("other"))
    nursery.finish(stores, collect=True, drive=False, look=False)
    assert all(contents(store) == collected for store in stores)
    again = [store.with_name("other") for store in stores]
    for after, keys in zip(nursery.finish(again, look=False), left, strict=True):
        assert sorted(after["computed"]) == sorted(everything - keys)
        halves = {name for name in after["tree"] if name.endswith(".tmp")}
        assert {name: sha256 for name, sha256 in after["tree"].items() if name not in halves} == undisturbed["tree"]


def test_a_discard_that_dies_leaves_what_the_next_one_ends(torture, nursery, undisturbed, place):
    """What is damaged is there, or in pieces, or gone, and nothing else is touched: it alone is computed again."""
    torture.times(1, 1)
    top = place()
    root = study_on_a_disk(nursery, top)
    everything = keys_of(root)
    manifests = [path for path in sorted(root.glob("items/*/*/*/manifest.json")) if "report" not in path.parts]
    damaged = {manifests[index].parent.name for index in torture.rng().permutation(len(manifests))[:3]}
    for manifest in manifests:
        if manifest.parent.name in damaged:
            file = next(path for path in sorted(manifest.parent.iterdir()) if path != manifest)
            file.write_bytes(file.read_bytes()[:-1] + b"?")
    stores = disks_left(torture, nursery, top, discard=True)
    for store in stores:
        assert {key for _, key in damaged_items(find_damage(Store.open(store, create=False)))} <= damaged
        assert keys_of(store) >= everything - damaged
    for after in nursery.finish(stores, discard=True):
        assert sorted(after["computed"]) == sorted(damaged)
        assert after["tree"] == undisturbed["tree"]
