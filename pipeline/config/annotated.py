"""Settings written out in full: YAML in which every value has its reason beside it, and which reads back as it was."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterator
from typing import Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

OPENING = (
    "Every setting, under its unit and its reason. [P]: the paper says so; the rest it leaves open, and was decided. "
    "A file needs only what differs from the default, and the defaults are the paper's study."
)
WIDTH = 110
"""Characters of a line of comment."""


def annotated_lines(settings: BaseModel) -> list[str]:
    """Write settings as YAML, each under its unit and reason, and beside it its default where that is another."""
    return [*_comment(OPENING, ""), "", *_fields(settings, "")]


def _fields(group: BaseModel, indent: str) -> Iterator[str]:
    for name, field in type(group).model_fields.items():
        value = getattr(group, name)
        yield from _comment(f"{field.description or ''} {_choices(field)}", indent)
        if isinstance(value, BaseModel):
            yield f"{indent}{name}:"
            yield from _fields(value, indent + "  ")
        else:
            default = field.get_default(call_default_factory=True)
            differs = "" if value == default else f"  # default: {_value(default)}"
            yield f"{indent}{name}: {_value(value)}{differs}"


def _choices(field: FieldInfo) -> str:
    """Name the words that a setting is one of."""
    if get_origin(field.annotation) is not Literal:
        return ""
    return f"One of: {', '.join(get_args(field.annotation))}."


def _comment(text: str, indent: str) -> list[str]:
    return textwrap.wrap(" ".join(text.split()), WIDTH, initial_indent=f"{indent}# ", subsequent_indent=f"{indent}# ")


def _value(value: object) -> str:
    """Write a value as JSON, which is YAML too; a plain word goes without quotes."""
    written = json.dumps(value, ensure_ascii=False)
    is_word = isinstance(value, str) and value.replace("_", "").isalpha() and value not in ("true", "false", "null")
    return str(value) if is_word else written
