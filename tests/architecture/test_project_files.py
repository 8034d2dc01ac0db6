"""The files that people expect in a project agree with the project: citation, contributions, workflow, commit hooks."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text())
WORKFLOW = yaml.safe_load((ROOT / ".github/workflows/test.yml").read_text())
HOOKS = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())


@pytest.mark.parametrize(
    ("file", "schema", "good", "bad"),
    [
        ("CITATION.cff", "citation-file-format", "type: software", "type: softwares"),
        (".github/workflows/test.yml", "github-workflows", "runs-on:", "run-on:"),
    ],
)
def test_a_file_conforms_to_its_schema(tmp_path, file, schema, good, bad):
    check = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", f"vendor.{schema}"]
    done = subprocess.run([*check, ROOT / file], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    slip = tmp_path / "slip.yaml"
    slip.write_text((ROOT / file).read_text().replace(good, bad, 1))
    assert subprocess.run([*check, slip], capture_output=True).returncode == 1


def test_the_workflow_runs_the_command_of_the_readme_on_every_supported_python():
    (job,) = WORKFLOW["jobs"].values()
    command = job["steps"][-1]["run"]
    assert command == "make test"
    lowest, highest = map(int, re.findall(r"3\.(\d+)", PROJECT["requires-python"]))
    assert job["strategy"]["matrix"]["python"] == [f"3.{minor}" for minor in range(lowest, highest)]
    assert WORKFLOW["permissions"] == {"contents": "read"}
