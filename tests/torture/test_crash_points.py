"""A study may die at any effect on the disk, or lose its power there, and ends in the same bytes.

A process that dies after an effect leaves what one leaves that dies before the next. So every point is tried, always,
with a real process that ends there; the power goes at every point too, and takes with it what was not synced.
"""

import shutil

import pytest


@pytest.fixture(scope="module")
def undisturbed(nursery, tmp_path_factory):
    """The study from beginning to end: its bytes, and the effects that made them."""
    (answer,) = nursery.finish([tmp_path_factory.mktemp("undisturbed") / "store"])
    assert sorted(answer["computed"]) == nursery.keys and len(answer["effects"]) > 150
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

    In small numbers the last three go through every fourth point.
    """
    n_effects = len(undisturbed["effects"])
    points = range(0 if loses == "all" else int(torture.rng().integers(4)), n_effects, 1 if loses == "all" else 4)
    points = range(n_effects) if torture.large else points
    torture.times(len(points), len(points))
    faults = [
        {"kind": "power", "at": at, "loses": loses, "seed": int(torture.rng().integers(2**32)) + at} for at in points
    ]
    strike_and_resume(nursery, undisturbed, place, faults)
