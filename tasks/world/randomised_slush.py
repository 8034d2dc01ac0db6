"""Randomised Slush: slushes whose parameters are drawn at random, the baseline of domain randomisation.

Tobin et al. 2017, "Domain Randomization for Transferring Deep Neural Networks from Simulation to the Real World":
where the true parameters are unknown, train in many simulations with random ones. It assumes what residual physics does
not: that the form of the missing physics is known. It requires no throws and no networks.
"""

from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from tasks.arrays import Float64
from tasks.seeding import generator
from tasks.world.environment import Environment
from tasks.world.medium import EnsembleMedium
from tasks.world.physics import Physics
from tasks.world.registry import EnvironmentKind, register
from tasks.world.slush import DragLaw, Slush

_DIGITS = 6  # significant digits of a parameter, so that members are the same wherever logarithms round differently

_Bound = Annotated[float, Field(gt=0.0, le=1e4)]


class RandomisedSlushes(DragLaw):
    """Slushes with random parameters, the same ones in every trial of a study, as the members of an ensemble are.

    The ranges are those of a designer who knows the kind of fluid and not its parameters. None is fitted to throws, and
    the chance that a member is close to the paper's slush in all three parameters is small.
    """

    n_members: int = Field(default=8, ge=1, le=64)
    """Number of slushes, each of which simulates every design; by default as many as networks."""
    density: tuple[_Bound, _Bound] = (1.0, 1.5)
    """Least and greatest density [kg/m²], drawn uniformly: links just float in the thinnest slush, and a third of a
    link is above the surface of the densest."""
    linear_drag: tuple[_Bound, _Bound] = (2.5, 40.0)
    """Least and greatest linear drag, drawn log-uniformly: a factor of 4 to either side of the paper's 10."""
    angular_drag: tuple[_Bound, _Bound] = (5.0, 80.0)
    """Least and greatest rotational drag, drawn log-uniformly: a factor of 4 to either side of the paper's 20."""
    seed: int | None = Field(default=None, ge=0, lt=2**63)
    """Seed of the draws; null takes the study's."""

    @model_validator(mode="after")
    def _bounds_are_in_order(self) -> Self:
        for name in ("density", "linear_drag", "angular_drag"):
            least, greatest = getattr(self, name)
            if least > greatest:
                raise ValueError(f"{name} is [{least:g}, {greatest:g}], expected the least value first")
        return self

    def of_study(self, seed: int) -> Self:
        """Return the slushes of a study with a seed, unless the settings state another."""
        return self.model_copy(update={"seed": seed}) if self.seed is None else self

    def slushes(self) -> tuple[Slush, ...]:
        """Draw the members; each depends on the seed and on its own number only.

        Raises:
            ValueError: there is no seed.
        """
        if self.seed is None:
            raise ValueError("randomised_slush.seed is null, expected the seed of a study")
        return tuple(self._slush(generator(self.seed, "randomised slush", k)) for k in range(self.n_members))

    def _slush(self, rng: np.random.Generator) -> Slush:
        density = rng.uniform(*self.density)
        linear_drag, angular_drag = (
            np.exp(rng.uniform(*np.log(bounds))) for bounds in (self.linear_drag, self.angular_drag)
        )
        drawn = (float(f"{value:.{_DIGITS}g}") for value in (density, linear_drag, angular_drag))
        parameters = dict(zip(("density", "linear_drag", "angular_drag"), drawn, strict=True))
        return Slush(drag=self.drag, **parameters)

    def factors(self, physics: Physics) -> tuple[Float64, ...]:
        """Return the factors of every slush."""
        return tuple(map(np.array, zip(*(slush.factors(physics) for slush in self.slushes()), strict=True)))


@dataclass(frozen=True)
class RandomisedSlush(Environment):
    """Ẽ: Dry Land filled with slush of several random densities and drags; each member is a medium of its own."""

    is_ensemble: ClassVar[bool] = True

    random: RandomisedSlushes = field(default_factory=lambda: RandomisedSlushes(seed=1))

    @property
    def medium(self) -> EnsembleMedium:
        """All members."""
        return self.random


register(
    EnvironmentKind(
        name="randomised_slush",
        build=RandomisedSlush,
        settings_group="randomised_slush",
        settings=RandomisedSlushes,
        for_study=RandomisedSlushes.of_study,
        label="Randomised Slush",
        symbol="Ẽ",
        evolved="in Randomised Slush",
        about="Slushes of random density and drag, whose ranges are settings: domain randomisation. It knows the kind "
        "of fluid, as the networks do not, and has seen no throw. Fitness is the mean over these slushes minus their "
        "disagreement.",
        order=7,
    )
)
