"""The registry of environments: what a medium's file registers is what settings accept and what gets built."""

import dataclasses
import re

import pytest
from pydantic import ValidationError

from tasks.world import (
    ENVIRONMENTS,
    DryLand,
    RandomisedSlushes,
    ResidualSlush,
    Slush,
    TrueSlush,
    environment_kind,
    in_order,
)
from tasks.world.anisotropic_slush import AnisotropicSlush
from tasks.world.flowing_slush import FlowingSlush
from tasks.world.registry import register, settings_groups


class FlatEnsemble(Slush):
    """One member."""

    @property
    def n_members(self) -> int:
        return 1


def test_an_environment_is_built_from_its_settings_group() -> None:
    assert settings_groups() == {
        "slush": Slush,
        "anisotropic_slush": AnisotropicSlush,
        "flowing_slush": FlowingSlush,
        "randomised_slush": RandomisedSlushes,
    }
    for group in (Slush(density=2.0), {"density": 2.0}):
        built = ENVIRONMENTS["true_slush"].environment(3.0, {"slush": group})
        assert built == TrueSlush(3.0, Slush(density=2.0))
    assert ENVIRONMENTS["dry_land"].environment(3.0, {}) == DryLand(3.0)
    with pytest.raises(ValidationError, match="viscosity"):
        ENVIRONMENTS["true_slush"].environment(3.0, {"slush": {"viscosity": 2.0}})


@pytest.mark.parametrize("name", ["residual_slush", "single_member", "fifty_throws"])
def test_an_environment_of_networks_requires_an_ensemble(name: str) -> None:
    ensemble = FlatEnsemble()
    built = environment_kind(name).environment(3.0, {}, ensemble)
    assert built == ResidualSlush(3.0, ensemble)
    assert built.is_ensemble and built.n_members == 1
    with pytest.raises(ValueError, match=f"{name}: expected an ensemble of trained networks, got None"):
        environment_kind(name).environment(3.0, {})


def test_a_learner_of_a_study_is_called_by_its_name() -> None:
    assert environment_kind("fifty_throws").label == "Fifty throws" and environment_kind("fifty_throws").learned
    assert [environment_kind(name) for name in ENVIRONMENTS] == list(ENVIRONMENTS.values())
    names = ["fifty_throws", "randomised_slush", "true_slush", "fifty_throws"]
    assert in_order(names) == ["true_slush", "fifty_throws", "randomised_slush"]


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
