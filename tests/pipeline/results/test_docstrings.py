"""The examples in the docstrings of `import puddle`, run."""

import doctest
import inspect
import shutil
from dataclasses import replace
from pathlib import Path
from unittest.mock import create_autospec

import numpy as np
import pytest

import puddle
from pipeline.store.store import Store

FUNCTIONS = {name: value for name in puddle.__all__ if inspect.isfunction(value := getattr(puddle, name))}


@pytest.fixture
def at_home(recorded, tmp_path, monkeypatch):
    """A folder with docs and a store, as users have it; its study ``laptop`` is the small recorded one."""
    store = Store.open(shutil.copytree(recorded, tmp_path / "store"), create=False)
    record = store.read_study("tiny")
    store.write_study(replace(record, name="laptop", settings={**record.settings, "name": "laptop"}))
    (tmp_path / "docs").symlink_to(Path(puddle.__file__).parents[1] / "docs")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(puddle, "run_study", create_autospec(puddle.run_study), raising=False)  # it takes a minute


@pytest.mark.parametrize("name", FUNCTIONS)
def test_an_example_runs(name, at_home):
    finder, names = doctest.DocTestFinder(recurse=False), {"np": np, "puddle": puddle}
    (example,) = finder.find(FUNCTIONS[name], name, globs=names)
    assert example.examples
    assert doctest.DocTestRunner().run(example).failed == 0
