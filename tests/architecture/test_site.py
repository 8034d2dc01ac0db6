"""The site of the docs: it is built without a warning, and its reference has all that users import."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import puddle

ROOT = Path(__file__).parents[2]


def test_the_site_is_built_with_a_reference_of_the_interface(tmp_path):
    pytest.importorskip("mkdocstrings", reason="mkdocs is not installed: make setup EXTRAS=docs")
    build = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(tmp_path)]
    done = subprocess.run([*build, "--config-file", "docs/site/mkdocs.yml"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    reference = (tmp_path / "api.html").read_text()
    named = set(re.findall(r'<h2 id="puddle\.(\w+)"', reference))
    assert named == {*puddle.__all__} - {"GENES"}
    assert "long axis of a link, its height [m]" in reference  # a comment beside a field of Designs
    assert "champions()" in reference and ":class:" not in reference and "``" not in reference
    for page in tmp_path.glob("*.html"):
        for link in re.findall(r'(?:href|src)="(?!https?:|mailto:|#)([^"#?]+)', page.read_text()):
            assert (page.parent / link).exists() or page.name == "404.html", (page.name, link)
