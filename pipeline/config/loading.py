"""Loading of settings: YAML and ``--set a.b=c`` become a typed, frozen model, or errors with file and line.

Words mean what YAML 1.2 says (1e-3 is a number, ``no`` is text), not what PyYAML makes of them. Types are strict: text
is not converted to a number, but a whole number may be written as 5e4.
"""

from __future__ import annotations

import difflib
import json
import math
import re
from collections.abc import Iterator, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError

from pipeline.errors import PuddleError

PRESETS = Path(str(files("pipeline") / "presets")).resolve()
"""Folder of the presets, which a checkout has as configs/. Only the driver reads them."""

_SET = "--set "

M = TypeVar("M", bound=BaseModel)
Scalar: TypeAlias = bool | int | float | str | None
Location: TypeAlias = tuple[int | str, ...]
Places: TypeAlias = dict[Location, str]
"""Where each value is written: ``FILE:LINE`` or ``--set a.b=c``."""


def preset_names() -> list[str]:
    """Return the names of the presets in configs/."""
    return sorted(path.stem for path in PRESETS.glob("*.yaml"))


def preset_path(name: str) -> Path:
    """Return a preset's file; the error for an unknown name lists the presets."""
    names = preset_names()
    if name not in names:
        raise PuddleError(f"preset {name!r}: expected one of {', '.join(names)}{_did_you_mean(name, names)}")
    return PRESETS / f"{name}.yaml"


def load(model: type[M], path: Path, overrides: Sequence[str] = ()) -> M:
    """Return the settings in a file.

    Args:
        model: class of the settings.
        path: a YAML file with the settings that differ from the model's defaults.
        overrides: assignments ``a.b=c``, where c is YAML on one line; later ones win.

    Raises:
        PuddleError: one line per mistake, with its file and line or its override, what was expected and what was found.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise PuddleError(f"{path}: expected a settings file, got: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise PuddleError(f"{path}: expected UTF-8 text: {error}") from None
    return parse(model, text, name=str(path), overrides=overrides)


def parse(model: type[M], text: str, *, name: str, overrides: Sequence[str] = ()) -> M:
    """Return the settings in YAML text, which error messages call ``name``; otherwise as :func:`load`."""
    places: Places = {(): name}
    settings = _read(text, name, places=places)
    if not isinstance(settings, dict | None):
        raise PuddleError(f"{places[()]}: expected settings like `name: value`, got {_show(settings)}")
    settings, places[()] = settings or {}, name
    for override in overrides:
        _override(settings, places, override)
    try:
        # In JSON mode, strict pydantic distinguishes numbers from text and still accepts a list for a tuple.
        return model.model_validate_json(json.dumps(settings), strict=True)
    except ValidationError as errors:
        found = errors.errors(include_url=False)
        # If pydantic refuses an element of a list, it also reports that the list is too short.
        faulty = {error["loc"][:depth] for error in found for depth in range(len(error["loc"]))}
        found = [error for error in found if error["type"] != "too_short" or error["loc"] not in faulty]
        raise PuddleError("\n".join(_explain(model, settings, places, error) for error in found)) from None


# The plain words of YAML 1.2's core schema, without infinities: https://yaml.org/spec/1.2.2/#103-core-schema
_WORDS = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")


def _read(text: str, name: str, *, places: Places, where: str = "", location: Location = ()) -> Any:
    """Return the value of YAML text at a location, and add its places: ``NAME:LINE``, or ``where`` for all."""
    try:
        node = yaml.compose(text, yaml.SafeLoader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        said = [getattr(error, "context", None), getattr(error, "problem", None)]
        problem = ", ".join(filter(None, said)) or " ".join(str(error).split())
        raise PuddleError(f"{where or (f'{name}:{mark.line + 1}' if mark else name)}: {problem}") from None
    except RecursionError:
        raise PuddleError(f"{where or name}: lists or mappings are too deeply nested") from None

    def line_of(node: yaml.Node) -> str:
        return where or f"{name}:{node.start_mark.line + 1}"

    def value(node: yaml.Node, location: Location, at: str) -> Any:
        places[location] = at
        if isinstance(node, yaml.ScalarNode):
            return _scalar(node, at)
        if isinstance(node, yaml.SequenceNode):
            return [value(item, (*location, index), line_of(item)) for index, item in enumerate(node.value)]
        members: dict[str, Any] = {}
        for key, item in node.value:
            at = line_of(key)  # a mistake in a group is located at its name
            if not isinstance(key, yaml.ScalarNode):
                raise PuddleError(f"{at}: expected a name before the colon, got a list or a group")
            if key.value in members:
                raise PuddleError(f"{at}: {key.value!r} appears twice")
            members[key.value] = value(item, (*location, key.value), at)
        return members

    return None if node is None else value(node, location, line_of(node))


def _scalar(node: yaml.ScalarNode, at: str) -> Scalar:
    word = str(node.value)
    if node.style is not None:  # quoted, or a block of text
        return word
    if word in _WORDS:
        return _WORDS[word]
    if not _NUMBER.fullmatch(word):
        return word
    number = float(word)
    if not math.isfinite(number):
        raise PuddleError(f"{at}: expected a number below 1e308, got {_show(word)}")
    if number.is_integer() and abs(number) < 2**53:
        return int(number)  # 5e4 is a whole number too
    return int(word) if word.lstrip("+-").isdecimal() else number


def _override(settings: dict[str, Any], places: Places, override: str) -> None:
    """Apply the assignment ``a.b=c``."""
    where = f"{_SET}{override}"
    path, equals, text = override.partition("=")
    names = tuple(path.split("."))
    if not equals or not all(names):
        raise PuddleError(f"{where}: expected a setting's name, = and its value, such as grid.n_trials=3")
    new: Places = {names: where}
    value = _read(text, where, places=new, where=where, location=names)
    if isinstance(value, dict) and not text.lstrip().startswith("{"):
        raise PuddleError(f"{where}: expected a value, a list [..] or a group {{..}}, got a colon (quote it)")
    group = settings
    for depth, name in enumerate(names[:-1], 1):
        at = places.setdefault(names[:depth], where)
        group = group.setdefault(name, {})
        if not isinstance(group, dict):
            said = f"{'.'.join(names[:depth])}: expected a group of settings, got {_show(group)} at {at}"
            raise PuddleError(f"{where}: {said}")
    group[names[-1]] = value
    for replaced in [location for location in places if location[: len(names)] == names]:
        del places[replaced]
    places |= new


_EXPECTATIONS = {
    "Input should be a valid array": "expected a list",
    "Input should be an object": "expected a group of settings",
    "Input should be a valid boolean": "expected true or false",
    "Input should be a valid string": "expected text",
    "Input should be a valid integer": "expected a whole number",
    "Input should be a valid number": "expected a number",
    "Input should be greater": "expected a number greater",
    "Input should be less": "expected a number less",
    "Input should be ": "expected ",
    "Input should ": "expected to ",
    "String should match pattern": "expected text of the pattern",
}  # beginnings of pydantic's messages, and what to write


def _explain(model: type[BaseModel], settings: Any, places: Places, error: Any) -> str:
    """Describe one mistake in one line: its location, what was expected, what was found."""
    location: Location = error["loc"]
    place, field = _place(settings, location)
    where, kind, said = places[place], error["type"], error["msg"]
    if kind == "extra_forbidden":
        known = sorted({name for group in _groups(model, location[:-1]) for name in group.model_fields})
        return f"{where}: {field}: unknown setting{_did_you_mean(str(location[-1]), known)}; known: {', '.join(known)}"
    if kind == "missing":
        return f"{where}: {field}: expected a value, got none"
    at = f": {field}" if field else ""
    if kind == "value_error":  # several values contradict one another; overrides may have supplied some of them
        inside = (at for one, at in places.items() if one[: len(place)] == place and at.startswith(_SET))
        where = " with ".join(dict.fromkeys([where, *inside]))
        return f"{where}{at}: {said.removeprefix('Value error, ')}"
    if kind == "too_short":
        least, n = error["ctx"]["min_length"], error["ctx"]["actual_length"]
        return f"{where}{at}: expected at least {least} value{'s' * (least > 1)}, got {n}"
    words = next((words for words in _EXPECTATIONS if said.startswith(words)), "")
    return f"{where}{at}: {_EXPECTATIONS.get(words, '')}{said.removeprefix(words)}, got {_show(error['input'])}"


def _place(settings: Any, location: Location) -> tuple[Location, str]:
    """Return where in the settings a mistake is, the group if a value is missing, and its dotted name.

    Pydantic's locations also name the alternative of a union that it tried; such parts match nothing in the file.
    """
    value, place, name = settings, list[int | str](), ""
    for index, part in enumerate(location):
        if isinstance(part, int) if isinstance(value, list) else isinstance(value, dict) and part in value:
            value = value[part]
            place.append(part)
            name += f"[{part}]" if isinstance(part, int) else f".{part}"
        elif index == len(location) - 1:
            name += f".{part}"
    return tuple(place), name.lstrip(".")


def _groups(model: type[BaseModel], location: Location) -> list[type[BaseModel]]:
    groups = [model]
    for part in location:
        annotations = [group.model_fields[part].annotation for group in groups if part in group.model_fields]
        groups = [inner for annotation in annotations for inner in _models_in(annotation)] or groups
    return groups


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models_in(argument)


def _did_you_mean(name: str, known: Sequence[str]) -> str:
    close = difflib.get_close_matches(name, known, n=1)
    return f"; did you mean {close[0]}?" if close else ""


def _show(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 80 else f"{text[:77]}..."
