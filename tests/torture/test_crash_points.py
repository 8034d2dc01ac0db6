"""A study may die at any effect on the disk, or lose its power there, and ends in the same bytes.

Every point is tried, always: the number follows from the study, which is small in `make test` and has every stage's
work with --torture. A process that dies after an effect leaves what one leaves that dies before the next one.
"""

import pytest


@pytest.fixture(scope="module")
def undisturbed(nursery, tmp_path_factory):
    """The study from beginning to end: its bytes, and the effects that made them."""
    root = tmp_path_factory.mktemp("undisturbed") / "store"
    answer = nursery.finish(root, fault={"kind": "die", "at": -1})
    assert sorted(answer["computed"]) == nursery.keys and len(answer["effects"]) > 300
    return answer


def resumes(nursery, root, died, undisturbed) -> None:
    """Check that the next driver brings the same bytes, and that whatever was committed is not computed again."""
    assert died["status"] == 9, died
    resumed = nursery.finish(root)
    assert not set(resumed["computed"]) & set(died["committed"])
    assert resumed["tree"] == undisturbed["tree"]


def test_the_process_dies_before_any_effect(torture, nursery, undisturbed, place):
    n_effects = len(undisturbed["effects"])
    for at in range(torture.times(n_effects, n_effects)):
        root = place() / "store"
        resumes(nursery, root, nursery.drive(root, fault={"kind": "die", "at": at}), undisturbed)


def test_the_process_dies_half_way_through_any_write(torture, nursery, undisturbed, place):
    writes = [at for at, effect in enumerate(undisturbed["effects"]) if effect == "write"]
    torture.times(len(writes), len(writes))
    for at in writes:
        root = place() / "store"
        resumes(nursery, root, nursery.drive(root, fault={"kind": "tear", "at": at}), undisturbed)


@pytest.mark.parametrize("loses", ["all", "contents", "names", "some"])
def test_the_power_goes_before_any_effect(torture, nursery, undisturbed, place, loses):
    """What was not synced is lost: all of it, the contents alone, the names alone, or some of it by chance."""
    torture.times(len(undisturbed["effects"]), len(undisturbed["effects"]))
    seeds = torture.rng().integers(2**32, size=len(undisturbed["effects"])).tolist()
    for at, seed in enumerate(seeds):
        top = place()
        fault = {"kind": "power", "at": at, "loses": loses, "seed": seed, "image": str(top / "found")}
        (top / "disk").mkdir()
        died = nursery.drive(top / "disk" / "store", fault=fault)
        resumes(nursery, top / "found" / "store", died, undisturbed)
