"""Loading of settings: YAML and ``--set a.b=c`` become a typed, frozen model, or errors with file and line.

Only plain YAML values are accepted: no anchors, aliases, tags or repeated keys. Words mean what YAML 1.2 says (1e-3 is
a number, ``no`` is text), not what PyYAML makes of them. Types are strict: text is not converted to a number, but a
whole number may be written as 5e4.
"""

from __future__ import annotations

import difflib
import json
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError

from pipeline.errors import PuddleError

PRESETS = Path(str(files("pipeline") / "presets")).resolve()
"""Folder of the presets, which a checkout has as configs/. Only the driver reads them."""

_MAX_BYTES = 2**20
_MAX_NESTING = 32
_SET = "--set "

M = TypeVar("M", bound=BaseModel)
Scalar: TypeAlias = bool | int | float | str | None
Location: TypeAlias = tuple[int | str, ...]


@dataclass(frozen=True)
class Value:
    """A value of a settings file and its location: ``FILE:LINE`` or ``--set a.b=c``."""

    content: Scalar | list[Value] | dict[str, Value]
    where: str


def preset_names() -> list[str]:
    """Return the names of the presets in configs/."""
    return sorted(path.stem for path in PRESETS.glob("*.yaml"))


def preset_path(name: str) -> Path:
    """Return a preset's file; the error for an unknown name lists the presets."""
    names = preset_names()
    if name not in names:
        known = f"one of {', '.join(names)}" if names else f"a file of {PRESETS}, which holds none"
        raise PuddleError(f"preset {name!r}: expected {known}{_did_you_mean(name, names)}")
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
        with path.open("rb") as file:
            data = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise PuddleError(f"{path}: expected a settings file, got: {error.strerror}") from error
    if len(data) > _MAX_BYTES:
        raise PuddleError(f"{path}: expected at most {_MAX_BYTES} bytes of settings, got more. Is it the right file?")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise PuddleError(f"{path}:{line}: expected UTF-8 text, got the byte 0x{data[error.start]:02x}") from None
    return parse(model, text, name=str(path), overrides=overrides)


def parse(model: type[M], text: str, *, name: str, overrides: Sequence[str] = ()) -> M:
    """Return the settings in YAML text.

    Args:
        model: class of the settings.
        text: YAML with the settings that differ from the model's defaults.
        name: what error messages call the text.
        overrides: assignments ``a.b=c``; later ones win.

    Raises:
        PuddleError: as in :func:`load`.
    """
    document = _compose(text, name)
    if not isinstance(document.content, dict | None):
        raise PuddleError(f"{document.where}: expected settings like `name: value`, got {_show(_plain(document))}")
    root = Value(document.content or {}, name)
    for override in overrides:
        root = _override(root, override)
    try:
        # In JSON mode, strict pydantic distinguishes numbers from text and still accepts a list for a tuple.
        return model.model_validate_json(json.dumps(_plain(root)), strict=True)
    except ValidationError as errors:
        found = errors.errors(include_url=False)
        # If pydantic refuses an element of a list, it also reports that the list is too short.
        faulty = {error["loc"][:depth] for error in found for depth in range(len(error["loc"]))}
        found = [error for error in found if error["type"] != "too_short" or error["loc"] not in faulty]
        raise PuddleError("\n".join(_explain(model, root, error) for error in found)) from None


class _Loader(yaml.SafeLoader):
    """PyYAML's composer without aliases, anchors, tags and deep nesting."""

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        self.depth += 1
        problem = None
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            problem = "expected plain values, got an anchor or an alias"
        elif getattr(event, "tag", None) is not None:
            problem = f"expected plain values, got the tag {event.tag}"
        elif self.depth > _MAX_NESTING:
            problem = f"expected at most {_MAX_NESTING} levels of nesting"
        if problem:
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
        node: yaml.Node | None = super().compose_node(parent, index)
        self.depth -= 1
        return node


# The plain words of YAML 1.2's core schema, without infinities: https://yaml.org/spec/1.2.2/#103-core-schema
_NULL = re.compile(r"~|null|Null|NULL|")
_BOOL = re.compile(r"(true|True|TRUE)|false|False|FALSE")
_INT = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")


def _compose(text: str, name: str, where: str | None = None) -> Value:
    """Parse YAML text, null if empty. Values are located at ``NAME:LINE``, or all at ``where``."""
    try:
        node = yaml.compose(text, _Loader)
        return Value(None, where or name) if node is None else _value(node, name, where)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        at = where or (f"{name}:{mark.line + 1}" if mark else name)
        problem = ", ".join(part for part in (error.context, error.problem) if part)
        raise PuddleError(f"{at}: {problem}") from None
    except yaml.reader.ReaderError as error:
        at = where or f"{name}:{text.count(chr(10), 0, error.position) + 1}"
        raise PuddleError(f"{at}: expected text, got the character {chr(error.character)!r}") from None


def _value(node: yaml.Node, name: str, where: str | None) -> Value:
    at = where or f"{name}:{node.start_mark.line + 1}"
    if isinstance(node, yaml.ScalarNode):
        return Value(_scalar(node, at), at)
    if isinstance(node, yaml.SequenceNode):
        return Value([_value(item, name, where) for item in node.value], at)
    members: dict[str, Value] = {}
    for key, item in node.value:
        line = f"{name}:{key.start_mark.line + 1}"
        if not isinstance(key, yaml.ScalarNode):
            raise PuddleError(f"{where or line}: expected a name before the colon, got a list or a group")
        if key.value in members:
            first = "" if where else f", first at {members[key.value].where}"
            raise PuddleError(f"{where or line}: {key.value!r} appears twice{first}")
        value = _value(item, name, where)
        members[key.value] = Value(value.content, where or line)  # a mistake in a group is located at its name
    return Value(members, at)


def _scalar(node: yaml.ScalarNode, at: str) -> Scalar:
    word = node.value
    if node.style is not None:  # quoted, or a block of text
        return str(word)
    if _NULL.fullmatch(word):
        return None
    if found := _BOOL.fullmatch(word):
        return found[1] is not None
    if not _FLOAT.fullmatch(word):
        return str(word)
    number = float(word)
    if not math.isfinite(number) or len(word) > 400:  # Python refuses to parse integers of more than 4300 digits
        raise PuddleError(f"{at}: expected a number below 1e308, got {_show(word)}")
    if _INT.fullmatch(word):
        return int(word)
    return int(number) if number.is_integer() and abs(number) < 2**53 else number  # 5e4 is a whole number too


def _plain(value: Value) -> Any:
    if isinstance(value.content, dict):
        return {name: _plain(inner) for name, inner in value.content.items()}
    if isinstance(value.content, list):
        return [_plain(inner) for inner in value.content]
    return value.content


def _override(root: Value, override: str) -> Value:
    """Return the settings with the assignment ``a.b=c`` applied."""
    where = f"{_SET}{override}"
    path, equals, text = override.partition("=")
    names = path.split(".")
    if not equals or not all(names):
        raise PuddleError(f"{where}: expected a setting's name, = and its value, such as grid.n_trials=3")
    if "\n" in text:
        raise PuddleError(f"{where}: expected a value on one line")
    value = _compose(text, name=where, where=where)
    if isinstance(value.content, dict) and not text.lstrip().startswith("{"):
        raise PuddleError(f"{where}: expected a value, a list [..] or a group {{..}}, got a colon (quote it)")
    return _replaced(root, names, value)


def _replaced(group: Value, names: Sequence[str], value: Value, above: str = "") -> Value:
    if not names:
        return value
    if not isinstance(group.content, dict):
        got = _show(_plain(group))
        raise PuddleError(f"{value.where}: {above}: expected a group of settings, got {got} at {group.where}")
    inner = group.content.get(names[0], Value({}, value.where))
    path = f"{above}.{names[0]}".lstrip(".")
    return Value({**group.content, names[0]: _replaced(inner, names[1:], value, path)}, group.where)


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


def _explain(model: type[BaseModel], root: Value, error: Any) -> str:
    """Describe one mistake in one line: its location, what was expected, what was found."""
    location: Location = error["loc"]
    value, field = _place(root, location)
    where, kind, said = value.where, error["type"], error["msg"]
    if kind == "extra_forbidden":
        known = sorted({name for group in _groups(model, location[:-1]) for name in group.model_fields})
        return f"{where}: {field}: unknown setting{_did_you_mean(str(location[-1]), known)}; known: {', '.join(known)}"
    if kind == "missing":
        return f"{where}: {field}: expected a value, got none"
    at = f": {field}" if field else ""
    if kind == "value_error":  # several values contradict one another; overrides may have supplied some of them
        where = " with ".join(dict.fromkeys([where, *_overrides_in(value)]))
        return f"{where}{at}: {said.removeprefix('Value error, ')}"
    if kind == "too_short":
        least, n = error["ctx"]["min_length"], error["ctx"]["actual_length"]
        return f"{where}{at}: expected at least {least} value{'s' * (least > 1)}, got {n}"
    words = next((words for words in _EXPECTATIONS if said.startswith(words)), "")
    return f"{where}{at}: {_EXPECTATIONS.get(words, '')}{said.removeprefix(words)}, got {_show(error['input'])}"


def _place(root: Value, location: Location) -> tuple[Value, str]:
    """Return the value at a location and its dotted name, or its group if the file has no such value.

    Pydantic's locations also name the alternative of a union that it tried; such parts match nothing in the file.
    """
    value, names = root, []
    for index, part in enumerate(location):
        content = value.content
        if isinstance(part, int) and isinstance(content, list):
            value = content[part]
            names.append(f"[{part}]")
        elif isinstance(content, dict) and str(part) in content:
            value = content[str(part)]
            names.append(f".{part}")
        elif index == len(location) - 1:
            names.append(f".{part}")
    return value, "".join(names).lstrip(".")


def _overrides_in(value: Value) -> Iterator[str]:
    if value.where.startswith(_SET):
        yield value.where
    inner = value.content
    for one in inner.values() if isinstance(inner, dict) else inner if isinstance(inner, list) else ():
        yield from _overrides_in(one)


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
