"""A study may die, or lose power, at any effect on the disk, and the next run still ends in the same bytes.

The study has three parts: evolution and transfer, the analyses, and the report, which also replaces a folder of copies.
Every point of the first and the last is tried, always, though in the last with two kinds of faults; the analyses, which
commit as evolution does, and all kinds of faults, with --torture. A process that dies leaves on the disk what it has
written, and nothing else matters to the next one. So one run is surveyed for the disks that every fault at every point
would leave, and a real driver continues from each distinct disk. That processes which really die leave the disks that
the survey predicts is tested too: at random points, and with --torture at all of them.
"""

import hashlib
import shutil
from pathlib import Path

import pytest

from pipeline.commands.damage import find_damage
from pipeline.store.store import Store, StudyRecord

pytestmark = pytest.mark.timeout(1800)  # the machine may be busy

KINDS = ["die", "tear", "all", "contents", "names", "some"]
"""Faults: death before an effect, death half-way through a write, and power cuts that lose all unsynced data, contents
alone, names alone, or some of both at random."""


LAST = "transfer"
"""Last stage of the first part, which most of the tests run alone."""


@pytest.fixture(scope="module")
def undisturbed(fork_server, tmp_path_factory):
    """The first part from beginning to end: its bytes, and the effects that made them."""
    (answer,) = fork_server.finish([tmp_path_factory.mktemp("undisturbed") / "store"], last=LAST)
    assert len(answer["computed"]) == len(answer["committed"]) == 4 and len(answer["effects"]) > 80
    return answer


PARTS = {"science": (None, LAST, 4), "analyses": (LAST, "analyse", 5), "report": ("analyse", "report", 3)}
"""Parts of the study: the last stage before it, its own last stage, and the number of items that it computes."""


def survey(fork_server, top: Path, kinds: list[str], seed: int, points: list[int] | None = None, **command) -> dict:
    """Run a study, and write to ``top/found`` every distinct disk that faults of some kinds would leave."""
    for name in ("disk", "found"):
        (top / name).mkdir(exist_ok=True)
    (answer,) = fork_server.finish(
        [top / "disk" / "store"],
        survey={"kinds": kinds, "seed": seed, "points": points},
        into=str(top / "found"),
        inspect=False,
        **command,
    )
    return answer


def resume(fork_server, undisturbed, stores: list[Path], committed: list[list[str]], **command) -> None:
    """Check that the next driver ends in the same bytes, and computes nothing again that was committed."""
    for begin in range(0, len(stores), 40):
        some = slice(begin, begin + 40)
        answers = fork_server.finish(stores[some], inspect=False, **command)
        for after, before in zip(answers, committed[some], strict=True):
            assert not set(after["computed"]) & set(before)
            assert after["tree"] == undisturbed["tree"]
        for store in stores[some]:
            shutil.rmtree(store.parent)


@pytest.mark.parametrize("part", PARTS)
def test_the_next_driver_continues_from_any_disk_that_a_fault_leaves(torture, fork_server, new_folder, part):
    if part == "analyses" and not torture.large:
        pytest.skip("with --torture")
    before, last, n_items = PARTS[part]
    for rng in torture.attempts(1, 20):  # each attempt loses other data at random
        top = new_folder()
        if before:
            (top / "disk").mkdir()
            fork_server.finish([top / "disk" / "store"], last=before, inspect=False)
        kinds = KINDS if part == "science" or torture.large else ["die", "all"]
        found = survey(fork_server, top, kinds, int(rng.integers(2**32)), last=last)
        assert len(found["computed"]) == n_items and len(found["effects"]) > 80
        n_torn = found["effects"].count("write") if "tear" in kinds else 0
        faults = [tuple(fault) for disk in found["disks"] for fault in disk["faults"]]
        assert len(set(faults)) == len(faults) == (len(kinds) - ("tear" in kinds)) * len(found["effects"]) + n_torn
        stores = [top / "found" / str(number) / "store" for number in range(len(found["disks"]))]
        resume(fork_server, found, stores, [disk["committed"] for disk in found["disks"]], last=last)
        shutil.rmtree(top)


@pytest.mark.parametrize("kind", KINDS)
def test_a_process_that_dies_leaves_the_predicted_disk(torture, fork_server, undisturbed, new_folder, kind):
    """The process is real, and gone before the next one begins; `make test` tries a few random points."""
    effects = undisturbed["effects"]
    points = [at for at, effect in enumerate(effects) if kind != "tear" or effect == "write"]
    seed = int(torture.rng().integers(2**32))
    points = torture.rng().permutation(points).tolist()
    n_small = 2
    top = new_folder()
    predicted = survey(fork_server, top, [kind], seed, points if torture.large else points[:n_small], last=LAST)
    disk_at = {at: number for number, disk in enumerate(predicted["disks"]) for _, at in disk["faults"]}
    for at, _ in zip(points, torture.attempts(n_small, len(points)), strict=False):
        here = new_folder()
        (here / "disk").mkdir()
        fault = {"kind": kind, "at": at}
        if kind not in ("die", "tear"):
            fault = {"kind": "power", "at": at, "loses": kind, "seed": seed + at, "image": str(here / "found")}
        before = fork_server.drive(here / "disk" / "store", fault=fault, last=LAST)
        assert before["status"] == 9
        left = here / ("found" if fault["kind"] == "power" else "disk")
        assert contents(left) == contents(top / "found" / str(disk_at[at]))
        resume(fork_server, undisturbed, [left / "store"], [before["committed"]], last=LAST)
        shutil.rmtree(here)


def contents(disk: Path) -> dict[str, str | None]:
    """Return the SHA-256 of every file on a disk, None for its folders; locks are empty."""
    return {
        str(path.relative_to(disk)): None if path.is_dir() else hashlib.sha256(path.read_bytes()).hexdigest()
        for path in disk.rglob("*")
        if path.suffix != ".lock"
    }


# -- faults while files are removed ----------------------------------------------------------------------------------

KINDS_OF_REMOVAL = {"small": ["die", "all"], "large": [kind for kind in KINDS if kind != "tear"]}
"""Faults while files are removed: no write can be torn."""


def disks_left(torture, fork_server, top: Path, **command) -> list[Path]:
    """Remove files from the store ``top/disk/store``; return the stores that faults would leave of it."""
    (top / "found").mkdir()
    kinds = KINDS_OF_REMOVAL["large" if torture.large else "small"]
    (answer,) = fork_server.finish(
        [top / "disk" / "store"],
        drive=False,
        inspect=False,
        into=str(top / "found"),
        survey={"kinds": kinds, "seed": int(torture.rng().integers(2**32))},
        **command,
    )
    assert {"unlink", "fsync"} <= set(answer["effects"])
    return [top / "found" / str(number) / "store" for number in range(len(answer["disks"]))]


def keys_of(root: Path) -> set[str]:
    """Return the keys of all items in a store."""
    store = Store.open(root, create=False)
    return {key for stage in store.stages() for key in store.keys(stage)}


def finished_study(fork_server, top: Path) -> Path:
    """Run the first part to its end in the store ``top/disk/store``."""
    root = top / "disk" / "store"
    root.parent.mkdir()
    fork_server.finish([root], inspect=False, last=LAST)
    return root


def test_a_gc_that_dies_leaves_an_intact_store(torture, fork_server, undisturbed, new_folder):
    """Nothing is damaged in whatever is left; a study that needs it again continues from there, and the next gc
    completes the removal."""
    top = new_folder()
    root = finished_study(fork_server, top)
    everything = keys_of(root)
    store = Store.open(root, create=False)
    longer = store.read_study("tiny").settings
    shorter = {**longer, "evolution": {**longer["evolution"], "n_generations": 2}}
    store.write_study(StudyRecord("tiny", shorter, ()))  # it needs only the first work item of evolution
    half = root / "items" / "evolve" / "00" / ("0" * 64)
    half.mkdir(parents=True)
    for path in (half / ".history.parquet.tmp", store.study_path("tiny") / ".study.json.tmp"):
        path.write_bytes(b"half")
    stores = disks_left(torture, fork_server, top, collect=True)
    collected, needed = contents(root), keys_of(root)
    assert needed and len(everything - needed) == 3 and not half.exists()
    left = [keys_of(store) for store in stores]
    assert {len(keys) for keys in left} == set(range(len(needed), len(everything) + 1))
    for store, keys in zip(stores, left, strict=True):
        assert needed <= keys
        assert find_damage(Store.open(store, create=False)) == []
        shutil.copytree(store, store.with_name("other"))
    fork_server.finish(stores, collect=True, drive=False, inspect=False)
    assert all(contents(store) == collected for store in stores)
    again = [store.with_name("other") for store in stores]
    for after, keys in zip(fork_server.finish(again, inspect=False, last=LAST), left, strict=True):
        assert sorted(after["computed"]) == sorted(everything - keys)
        halves = {name for name in after["tree"] if name.endswith(".tmp")}
        assert {name: sha256 for name, sha256 in after["tree"].items() if name not in halves} == undisturbed["tree"]
