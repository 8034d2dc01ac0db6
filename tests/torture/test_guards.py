"""Every guard is tested: when one is removed, a test fails.

The plugin without_guards repeats the tests of its table with one guard removed, and passes a repetition that fails.
"""

from pathlib import Path

import pytest
from without_guards import GUARDS

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("guard", GUARDS)
def test_every_guard_has_a_test(guard):
    file, _, name = GUARDS[guard][0].partition("::")
    assert f"def {name.partition('[')[0]}" in (ROOT / file).read_text()


@pytest.mark.parametrize("kind", ["files", "folders"])
def test_without_its_fsync_a_power_cut_loses_committed_items(torture, fork_server, new_folder, kind):
    """The store is no longer a store, or has lost items; with the fsync it is intact (test_crash_points.py)."""
    torture.times(1, 1)
    top = new_folder()
    (top / "disk").mkdir()
    fault = {"kind": "power", "at": "end", "loses": "contents" if kind == "files" else "names"}
    died = fork_server.drive(
        top / "disk" / "store", fault={**fault, "image": str(top / "found")}, without=f"fsync of {kind}"
    )
    assert died["status"] == 9
    after = fork_server.drive(top / "found" / "store")
    assert "store.json: expected" in after.get("error", "") or set(after["computed"]) & set(died["committed"])
