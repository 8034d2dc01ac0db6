"""The files that people expect in a project are well formed: citation and workflow."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("file", "schema"), [("CITATION.cff", "citation-file-format"), (".github/workflows/test.yml", "github-workflows")]
)
def test_a_file_conforms_to_its_schema(file, schema):
    check = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", f"vendor.{schema}"]
    done = subprocess.run([*check, ROOT / file], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
