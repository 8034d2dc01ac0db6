"""Extensions: files in a folder of their kind that register something when they are imported, such as a medium."""

import importlib
import pkgutil
import traceback
from collections.abc import Iterable, MutableMapping
from typing import TypeVar

EntryT = TypeVar("EntryT")

FAILURES: list[str] = []
"""Files that could not be imported, with what is wrong, in a line each. All but what they register works."""


def import_extensions(package: str, folder: Iterable[str]) -> None:
    """Import every module in a package's folder; one that fails, perhaps a user's, is added to FAILURES."""
    for module in pkgutil.iter_modules(folder, f"{package}."):
        try:
            importlib.import_module(module.name)
        except Exception as error:
            FAILURES.append(located(error, module.name, module.name))


def with_failures(mistake: str) -> str:
    """Return a mistake about a name, and the files that could not be imported: one may have registered it."""
    return "; ".join([mistake, *FAILURES])


def register(registry: MutableMapping[str, EntryT], kind: str, name: str, entry: EntryT) -> None:
    """Add an entry to a registry of its kind; raise ValueError if the name is taken."""
    if name in registry:
        raise ValueError(f"{kind} {name!r} is registered twice, expected a name of its own")
    registry[name] = entry


def located(error: Exception, module: str, otherwise: str) -> str:
    """Describe an error in a line that begins with its place in a module; if it has none there, with ``otherwise``."""
    frames = traceback.walk_tb(error.__traceback__)
    places = [f"{one.f_code.co_filename}:{line}" for one, line in frames if one.f_globals.get("__name__") == module]
    said = str(error)
    if isinstance(error, SyntaxError):
        places, said = [f"{error.filename}:{error.lineno}"], error.msg
    return f"{places[-1] if places else otherwise}: {type(error).__name__}: {' '.join(said.split())}"
