"""The files that people expect in a project are well formed: citation and workflow."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("file", "schema"), [("CITATION.cff", "citation-file-format"), (".github/workflows/test.yml", "github-workflows")]
)
def test_a_file_conforms_to_its_schema(file, schema):
    check = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", f"vendor.{schema}"]
    done = subprocess.run([*check, ROOT / file], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def test_the_workflow_tests_every_supported_python():
    (job,) = yaml.safe_load((ROOT / ".github/workflows/test.yml").read_text())["jobs"].values()
    python = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["requires-python"]
    lowest, highest = map(int, re.findall(r"3\.(\d+)", python))
    assert job["strategy"]["matrix"]["python"] == [f"3.{minor}" for minor in range(lowest, highest)]
    assert job["steps"][-1]["run"] == "make test"
