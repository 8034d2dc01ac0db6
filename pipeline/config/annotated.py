"""Settings written out in full: YAML with every value's unit and reason, which loads as the same settings."""

import json
import textwrap
from collections.abc import Iterator
from typing import Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import to_jsonable_python

_OPENING = (
    "Every setting, below its unit and its reason. [P]: as in the paper; the paper does not specify the others. "
    "A file needs only what differs from the defaults, which are the paper's study."
)
_LINE_LENGTH = 110


def annotated_lines(settings: BaseModel) -> list[str]:
    """Write settings as YAML: above each its unit and reason, beside it its default if that differs."""
    return [*_comment(_OPENING, ""), "", *_fields(settings, "")]


def _fields(group: BaseModel, indent: str) -> Iterator[str]:
    for name, field in type(group).model_fields.items():
        value = getattr(group, name)
        yield from _comment(f"{field.description or ''} {_choices(field)}", indent)
        if isinstance(value, BaseModel):
            yield f"{indent}{name}:"
            yield from _fields(value, indent + "  ")
        else:
            default = field.get_default(call_default_factory=True)
            differs = "" if field.is_required() or value == default else f"  # default: {_value(default)}"
            yield f"{indent}{name}: {_value(value)}{differs}"
    yield from (f"{indent}{name}: {_value(value)}" for name, value in (group.model_extra or {}).items())


def _choices(field: FieldInfo) -> str:
    if get_origin(field.annotation) is not Literal:
        return ""
    return f"One of: {', '.join(get_args(field.annotation))}."


def _comment(text: str, indent: str) -> list[str]:
    prefix = f"{indent}# "
    return textwrap.wrap(" ".join(text.split()), _LINE_LENGTH, initial_indent=prefix, subsequent_indent=prefix)


def _value(value: object) -> str:
    """Write a value as JSON, which is also YAML."""
    return json.dumps(to_jsonable_python(value), ensure_ascii=False)
