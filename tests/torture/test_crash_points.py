"""A study may die at any effect on the disk, or lose its power there, and ends in the same bytes.

A process that dies after an effect leaves what one leaves that dies before the next. So every point is tried, always,
with a real process that ends there. The power goes too, at every point with --torture, and takes with it what was not
synced.
"""

import shutil

import pytest


@pytest.fixture(scope="module")
def undisturbed(nursery, tmp_path_factory):
    """The study from beginning to end: its bytes, and the effects that made them."""
    (answer,) = nursery.finish([tmp_path_factory.mktemp("undisturbed") / "store"])
    assert len(answer["computed"]) == len(answer["committed"]) == 12 and len(answer["effects"]) > 150
    return answer


def strike_and_resume(nursery, undisturbed, place, faults) -> None:
    """Check that the next driver brings the same bytes, and computes nothing again that was committed."""
    for begin in range(0, len(faults), 40):
        died, found = [], []
        for fault in faults[begin : begin + 40]:
            top = place()
            found.append(top / "found" / "store" if fault["kind"] == "power" else top / "disk" / "store")
            (top / "disk").mkdir()
            died.append(nursery.drive(top / "disk" / "store", fault={**fault, "image": str(top / "found")}))
        for before, after in zip(died, nursery.finish(found), strict=True):
            assert before["status"] == 9
            assert not set(after["computed"]) & set(before["committed"])
            assert after["tree"] == undisturbed["tree"]
        for store in found:
            shutil.rmtree(store.parents[1])


def test_the_process_dies_before_any_effect(torture, nursery, undisturbed, place):
    points = range(len(undisturbed["effects"]))
    torture.times(len(points), len(points))
    strike_and_resume(nursery, undisturbed, place, [{"kind": "die", "at": at} for at in points])


def test_the_process_dies_half_way_through_any_write(torture, nursery, undisturbed, place):
    writes = [at for at, effect in enumerate(undisturbed["effects"]) if effect == "write"]
    torture.times(len(writes), len(writes))
    strike_and_resume(nursery, undisturbed, place, [{"kind": "tear", "at": at} for at in writes])


@pytest.mark.parametrize("loses", ["all", "contents", "names", "some"])
def test_the_power_goes_before_any_effect(torture, nursery, undisturbed, place, loses):
    """What was not synced is lost: all of it; the contents alone, or the names alone; or some of it, by chance.

    In small numbers the first goes through every other point, the last three through every eighth.
    """
    n_effects, every = len(undisturbed["effects"]), 1 if torture.large else 2 if loses == "all" else 8
    points = range(int(torture.rng().integers(every)), n_effects, every)
    torture.times(len(points), len(points))
    faults = [
        {"kind": "power", "at": at, "loses": loses, "seed": int(torture.rng().integers(2**32)) + at} for at in points
    ]
    strike_and_resume(nursery, undisturbed, place, faults)


def test_a_dead_driver_leaves_nothing_that_a_cut_takes_from_the_next(torture, nursery, undisturbed, place):
    """The first dies at any effect; the second ends the study; then the power goes, and every byte is there.

    All but one piece at most: the one that the first had put in its place, and not synced there, when it died. In
    small numbers the first dies before every fsync that follows upon a new folder, and at some other points.
    """
    effects = undisturbed["effects"]
    telling = {at for at, effect in enumerate(effects) if effects[at - 1 : at] == ["mkdir"] or torture.large}
    points = sorted(telling | set(torture.rng().integers(len(effects), size=10).tolist()))
    torture.times(len(points), len(points))
    found = []
    for at in points:
        top = place()
        disk, account, image = top / "disk", str(top / "account"), str(top / "found")
        disk.mkdir()
        first = nursery.drive(disk / "store", fault={"kind": "die", "at": at, "leaves": account})
        fault = {"kind": "power", "at": "end", "takes": account, "loses": "all", "image": image}
        second = nursery.drive(disk / "store", fault=fault)
        assert (first["status"], second["status"]) == (9, 9)
        found.append(top / "found" / "store")
    for answer in nursery.finish(found):
        assert len(answer["computed"]) <= 1
        assert answer["tree"] == undisturbed["tree"]
