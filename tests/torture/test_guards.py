"""Every guard is tested: when one is removed, a test fails."""

import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from without_guards import GUARDS

ROOT = Path(__file__).parents[2]


def test_without_its_guard_every_test_fails(torture, tmp_path):
    torture.times(len(GUARDS), len(GUARDS))
    report = tmp_path / "report.xml"
    subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest",
            "-p",
            "without_guards",
            "-p",
            "no:cacheprovider",
            f"--junitxml={report}",
            *(test for test, _ in GUARDS.values()),
        ],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parent)},
        capture_output=True,
    )
    cases = list(ElementTree.parse(report).iter("testcase"))
    failed = {case.get("name"): case.find("failure").text for case in cases if case.find("failure") is not None}
    for guard, (test, _) in GUARDS.items():
        file, _, name = test.partition("::")
        ends = [text.splitlines()[-1] for one, text in failed.items() if one.startswith(name)]
        assert ends, f"no test fails without the {guard}: {sorted(failed)}"
        # the test itself must fail (an assert, pytest.raises), not the patch or something that it broke
        missed = re.compile(re.escape(file) + r":\d+: (AssertionError|Failed)")
        assert all(missed.fullmatch(end) for end in ends), f"without the {guard}, something else fails: {ends}"
    torture.note(f"removed one by one: the {', the '.join(GUARDS)}")


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
