"""Groups of parameters that a settings file may choose, declared next to the equations that use them.

Each group is a frozen model that rejects unknown names and non-finite numbers. Its fields document their unit and
reason. The pipeline nests the groups in its settings, so each parameter has one default and one range.
"""

from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel, ConfigDict


class Parameters(BaseModel):
    """A frozen, validated group of named parameters."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True, use_attribute_docstrings=True
    )

    def __repr_args__(self) -> Iterator[tuple[str | None, Any]]:
        """Show what differs from the defaults."""
        for name, value in super().__repr_args__():
            field = type(self).model_fields.get(name or "")
            if field is None or value != field.get_default(call_default_factory=True):
                yield name, value
