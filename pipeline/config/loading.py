"""Loading of settings: YAML and ``--set a.b=c`` become a typed, frozen model, or errors that name the setting.

Numbers are those of YAML 1.2: 050 is 50, and 1e-3 a number. A whole one may be written as 5e4.
"""

from __future__ import annotations

import difflib
import fnmatch
import json
import re
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from pipeline.errors import PuddleError
from tasks.discovery import with_failures

PRESETS = Path(str(files("pipeline") / "presets")).resolve()
"""Folder of the presets, which a checkout has as configs/. Only the driver reads them."""

M = TypeVar("M", bound=BaseModel)


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
        PuddleError: one line per mistake, with its file or its override, the setting, what was expected and what found.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise PuddleError(f"{path}: expected a settings file, got: {error.strerror}") from error
    return parse(model, content, name=str(path), overrides=overrides)


def parse(model: type[M], content: str | bytes, *, name: str, overrides: Sequence[str] = ()) -> M:
    """Return the settings in YAML, which error messages call ``name``; otherwise as :func:`load`."""
    settings = _read(content, name)
    if not isinstance(settings, dict | None):
        raise PuddleError(f"{name}: expected settings like `name: value`, got {_show(settings)}")
    settings = settings or {}
    for override in overrides:
        _override(settings, override)
    try:
        return model.model_validate_json(json.dumps(settings, default=str))
    except ValidationError as errors:
        found = errors.errors(include_url=False)
        # If pydantic refuses an element of a list, it also reports that the list is too short.
        faulty = {error["loc"][:depth] for error in found for depth in range(len(error["loc"]))}
        found = [error for error in found if error["type"] != "too_short" or error["loc"] not in faulty]
        mistakes = "\n".join(_explain(model, settings, name, overrides, error) for error in found)
        raise PuddleError(with_failures(mistakes)) from None


class _Loader(yaml.SafeLoader):
    """Reads numbers as YAML 1.2, leaves other words to the setting's type, and refuses a name that appears twice."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012 (PyYAML has it of each class)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        names = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        if twice := [name for name in names if names.count(name) > 1]:
            raise yaml.constructor.ConstructorError(None, None, f"{twice[0]!r} appears twice", node.start_mark)
        return super().construct_mapping(node, deep)


for _tag, _pattern, _first in (
    ("int", "[-+]?(0|[1-9][0-9]*)", "+-0123456789"),
    ("float", r"[-+]?((\.[0-9]+|[0-9]+(\.[0-9]*|(?=[eE])))([eE][-+]?[0-9]+)?|\.(inf|nan))", "+-.0123456789"),
    ("null", "~|null|Null|NULL|", ("~", "n", "N", "")),
    ("merge", "<<", "<"),
):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(f"(?:{_pattern})$"), _first)


def _read(content: str | bytes, name: str) -> Any:
    """Return the value of YAML."""
    try:
        value = yaml.load(content, _Loader)
        json.dumps(value, default=str)
        return value
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        problem = [getattr(error, "context", None), getattr(error, "problem", None)]
        said = ", ".join(filter(None, problem)) or " ".join(str(error).split())
        line = f":{mark.line + 1}" if mark and not name.startswith("--set") else ""
        raise PuddleError(f"{name}{line}: {said}") from None
    except (RecursionError, TypeError, ValueError):  # as of a list that contains itself
        raise PuddleError(f"{name}: expected lists and groups of plain values") from None


def _override(settings: dict[str, Any], override: str) -> None:
    """Apply the assignment ``a.b=c``."""
    where = f"--set {override}"
    path, equals, text = override.partition("=")
    *groups, name = path.split(".")
    if not equals or not all((*groups, name)):
        raise PuddleError(f"{where}: expected a setting's name, = and its value, such as grid.n_trials=3")
    value = _read(text, where)
    if isinstance(value, dict) and not text.lstrip().startswith("{"):
        raise PuddleError(f"{where}: expected a value, a list [..] or a group {{..}}, got a colon (quote it)")
    group = settings
    for part in groups:
        group = group.setdefault(part, {})
        if not isinstance(group, dict):
            raise PuddleError(f"{where}: {part}: expected a group of settings, got {_show(group)}")
    group[name] = value


def _explain(model: type[BaseModel], settings: Any, name: str, overrides: Sequence[str], error: Any) -> str:
    """Describe one mistake in one line: where it is, what was expected, what was found."""
    field = _field(settings, error["loc"])
    given = [(f"--set {override}", override.partition("=")[0]) for override in overrides]
    stated = [place for place, path in given if re.match(rf"{re.escape(path)}(\W|$)", field)]
    within = [place for place, path in given if not field or path.startswith(f"{field}.")]
    where = (stated[-1] if stated else " with ".join([name, *within])) + (f": {field}" if field else "")
    match error["type"]:
        case "extra_forbidden":
            return f"{where}: unknown setting{_other_setting(field, model.model_json_schema())}"
        case "missing":
            return f"{where}: expected a value, got none"
        case "value_error":
            return f"{where}: {error['msg'].removeprefix('Value error, ')}"
        case "too_short":
            return f"{where}: expected at least {error['ctx']['min_length']}, got {error['ctx']['actual_length']}"
    said = re.sub("^Input should (be )?", "expected ", error["msg"])
    return f"{where}: {said}, got {_show(error['input'])}"


def _other_setting(field: str, schema: Mapping[str, Any]) -> str:
    """Name a setting of the same group that is called much like an unknown one, or those of its name in others."""
    group, dot, word = field.rpartition(".")
    known, of_list = _all_settings(schema, schema.get("$defs", {})), re.sub(r"\[\d+]", "", group)
    if suggestion := _did_you_mean(word, [name for owner, name in known if fnmatch.fnmatch(of_list, owner)]):
        return suggestion.replace("mean ", f"mean {group}{dot}")
    others = [f"{owner}.{name}".lstrip(".") for owner, name in known if name == word and "*" not in owner]
    return f"; did you mean {' or '.join(others)}?" if others else ""


def _all_settings(schema: Mapping[str, Any], definitions: Mapping[str, Any], owner: str = "") -> list[tuple[str, str]]:
    """List the dotted names of all groups, each with a setting of it; * is a name that users choose."""
    known: list[tuple[str, str]] = []
    for name, value in schema.get("properties", {}).items():
        known.append((owner, name))
        within = f"{owner}.{name}{'.*' * (value.get('type') == 'object')}".lstrip(".")
        for group in re.findall(r"#/\$defs/(\w+)", json.dumps(value)):
            known += _all_settings(definitions[group], definitions, within)
    return known


def _field(value: Any, location: Sequence[int | str]) -> str:
    """Return the dotted name of a setting, without the alternatives of a union, which pydantic's location names too."""
    name = ""
    for index, part in enumerate(location):
        if isinstance(value, list) and isinstance(part, int):
            value = value[part] if part < len(value) else None  # pydantic names an element that is missing
            name += f"[{part}]"
        elif isinstance(value, dict) and part in value:
            value = value[part]
            name += f".{part}"
        elif index == len(location) - 1:
            name += f".{part}"
    return name.lstrip(".")


def _did_you_mean(name: str, known: Sequence[str]) -> str:
    close = difflib.get_close_matches(name, known, n=1)
    return f"; did you mean {close[0]}?" if close else ""


def _show(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 80 else f"{text[:77]}..."
