"""The registry of environments: what a medium's file registers is what settings accept and what gets built."""

import dataclasses
import re

import pytest
from pydantic import ValidationError

from tasks.world import ENVIRONMENTS, DryLand, RandomisedSlushes, Slush, TrueSlush
from tasks.world.anisotropic_slush import AnisotropicSlush
from tasks.world.falling_plate import FallingPlate
from tasks.world.flowing_slush import FlowingSlush
from tasks.world.fluid import FluidFlume
from tasks.world.mujoco_fluid import MujocoFluid
from tasks.world.registry import register, settings_groups


def test_an_environment_is_built_from_its_settings_group() -> None:
    assert settings_groups() == {
        "slush": Slush,
        "anisotropic_slush": AnisotropicSlush,
        "falling_plate": FallingPlate,
        "flowing_slush": FlowingSlush,
        "randomised_slush": RandomisedSlushes,
        "fluid": FluidFlume,
        "mujoco_fluid": MujocoFluid,
    }
    for group in (Slush(density=2.0), {"density": 2.0}):
        built = ENVIRONMENTS["true_slush"].environment(3.0, group)
        assert built == TrueSlush(3.0, Slush(density=2.0))
    assert ENVIRONMENTS["dry_land"].environment(3.0) == DryLand(3.0)
    with pytest.raises(ValidationError, match="viscosity"):
        ENVIRONMENTS["true_slush"].environment(3.0, {"viscosity": 2.0})


def test_a_name_is_registered_once() -> None:
    registered = dict(ENVIRONMENTS)
    with pytest.raises(ValueError, match="environment 'dry_land' is registered twice"):
        register(dataclasses.replace(ENVIRONMENTS["dry_land"], label="Another"))
    assert dict(ENVIRONMENTS) == registered


@pytest.mark.parametrize("depth", [-1e-9, -9, float("nan"), float("inf"), True, "1", None])
def test_other_depths_are_refused(depth) -> None:
    message = f"depth is {depth!r}, expected a finite number of metres, at least 0"
    with pytest.raises(ValueError, match=re.escape(message)):
        DryLand(depth)
