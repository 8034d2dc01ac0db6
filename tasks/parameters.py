"""Parameters: what a settings file may choose, stated next to the equation that uses it.

Each group of parameters is a frozen model that refuses unknown names and non-finite numbers, and whose fields carry
their unit and their reason. The pipeline nests these groups into its settings, so that a value has one default and one
bound.
"""

from pydantic import BaseModel, ConfigDict


class Parameters(BaseModel):
    """A frozen, validated group of named parameters."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True, use_attribute_docstrings=True
    )
