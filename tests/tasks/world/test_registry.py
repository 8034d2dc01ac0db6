"""The registry of environments: what a medium's file registers is what settings accept and what gets built."""

import dataclasses
import re

import pytest
from pydantic import ValidationError

from tasks.world import ENVIRONMENTS, DryLand, Slush, TrueSlush
from tasks.world.registry import register


def test_an_environment_is_built_from_its_settings_group() -> None:
    for group in (Slush(density=2.0), {"density": 2.0}):
        assert ENVIRONMENTS["true_slush"].environment(3.0, group) == TrueSlush(3.0, Slush(density=2.0))
    assert ENVIRONMENTS["dry_land"].environment(3.0) == DryLand(3.0)
    with pytest.raises(ValidationError, match="viscosity"):
        ENVIRONMENTS["true_slush"].environment(3.0, {"viscosity": 2.0})


def test_a_name_is_registered_once() -> None:
    with pytest.raises(ValueError, match="environment 'dry_land' is registered twice"):
        register(dataclasses.replace(ENVIRONMENTS["dry_land"], label="Another"))
    assert ENVIRONMENTS["dry_land"].label != "Another"


@pytest.mark.parametrize("depth", [-1e-9, -9, float("nan"), float("inf"), True, "1", None])
def test_other_depths_are_refused(depth) -> None:
    message = f"depth is {depth!r}, expected a finite number of metres, at least 0"
    with pytest.raises(ValueError, match=re.escape(message)):
        DryLand(depth)
