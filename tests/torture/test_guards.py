"""Every guard is needed: with one taken out, a test fails. So these tests would notice the day it goes missing."""

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
        assert ends, f"nothing fails without the {guard}: {sorted(failed)}"
        # what fails is what the test says of it (an assert, pytest.raises), and not the patch or what it broke
        missed = re.compile(re.escape(file) + r":\d+: (AssertionError|Failed)")
        assert all(missed.fullmatch(end) for end in ends), f"without the {guard} another thing fails: {ends}"
    torture.note(f"missed: the {', the '.join(GUARDS)}")


@pytest.mark.parametrize("kind", ["files", "folders"])
def test_without_its_fsync_a_cut_takes_what_was_committed(torture, nursery, place, kind):
    """After it the store is no store any more, or has lost items; with the fsync it is whole (test_crash_points.py)."""
    torture.times(1, 1)
    top = place()
    (top / "disk").mkdir()
    fault = {"kind": "power", "at": "end", "loses": "contents" if kind == "files" else "names"}
    died = nursery.drive(
        top / "disk" / "store", fault={**fault, "image": str(top / "found")}, without=f"fsync of {kind}"
    )
    assert died["status"] == 9
    after = nursery.drive(top / "found" / "store")
    assert "store.json: expected" in after.get("error", "") or set(after["computed"]) & set(died["committed"])
