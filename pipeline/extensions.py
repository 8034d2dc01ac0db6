"""Files of a user's own (``--with FILE``) that register a medium, a form, a controller, a search or an analysis.

The process that is given them reads them once. Every process imports their text, which an environment variable holds,
before it reads anything that may need them: so workers on other machines need no file.
"""

from __future__ import annotations

import importlib.util
import json
import linecache
import os
import sys
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

from pipeline.errors import PuddleError

VARIABLE = "PUDDLE_EXTENSIONS"


def given() -> dict[str, list[str]]:
    """Return the path and the text of each extension by the name of its module."""
    extensions: dict[str, list[str]] = json.loads(os.environ.get(VARIABLE, "{}"))
    return extensions


def add(files: Iterable[Path]) -> None:
    """Import files, and have every process that this one starts import them."""
    from tasks.discovery import located

    for file in files:
        path, name = file.expanduser().resolve(), file.stem
        known = given().get(name)
        if known and known[0] == str(path):
            continue
        if file.suffix != ".py" or not name.isidentifier() or known or importlib.util.find_spec(name):
            raise PuddleError(f"--with {file}: expected a file NAME.py whose name no other module has")
        os.environ[VARIABLE] = json.dumps(given() | {name: [str(path), path.read_text(encoding="utf-8")]})
        try:
            import_given()
        except Exception as error:
            raise PuddleError(f"--with {located(error, name, str(file))}") from error


def import_given() -> None:
    """Import the extensions that are not imported yet."""
    for name, (path, text) in given().items():
        if name not in sys.modules:
            sys.modules[name] = module = ModuleType(name)
            module.__file__ = path
            linecache.cache[path] = len(text), None, text.splitlines(keepends=True), path  # for tracebacks and inspect
            exec(compile(text, path, "exec"), vars(module))
