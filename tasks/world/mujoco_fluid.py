"""MuJoCo's fluid: the ellipsoid model of drag, lift and Magnus force that the engine MuJoCo has, below y = 0.

Nobody who wrote this package wrote that model, and nothing in it is learned from this one: a truth that is not of the
same hand as the law that is fitted to it. https://mujoco.readthedocs.io/en/stable/computation/fluid.html
"""

from typing import ClassVar

from pydantic import Field

from tasks.world.medium import NativeFluid
from tasks.world.registry import register_medium


class MujocoFluid(NativeFluid):
    """A fluid in MuJoCo: a link is an ellipsoid with the box's axes, and feels the forces by its submerged share.

    Coefficients are MuJoCo's ``fluidcoef``, by its defaults, and there is no viscosity. Buoyancy is the weight of what
    the box displaces, at its centre of mass.
    """

    engine: ClassVar[str] = "mujoco"

    density: float = Field(default=1.25, ge=0.0, le=1e4)
    """[kg/m²], of a layer 1 m thick; links float in 1.25 with 80 % submerged."""
    blunt_drag: float = Field(default=0.5, ge=0.0, le=1e3)
    """Drag coefficient of the broadside."""
    slender_drag: float = Field(default=0.25, ge=0.0, le=1e3)
    """Drag coefficient along the ellipsoid."""
    angular_drag: float = Field(default=1.5, ge=0.0, le=1e3)
    """Drag coefficient of rotation."""
    kutta_lift: float = Field(default=1.0, ge=0.0, le=1e3)
    """Coefficient of the lift of an inclined ellipsoid."""
    magnus_lift: float = Field(default=1.0, ge=0.0, le=1e3)
    """Coefficient of the Magnus force on a spinning one."""

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Coefficients in the order of MuJoCo's ``fluidcoef``."""
        return self.blunt_drag, self.slender_drag, self.angular_drag, self.kutta_lift, self.magnus_lift


register_medium(
    "mujoco_fluid",
    MujocoFluid,
    "MuJoCo's Fluid",
    symbol="M",
    about="The fluid of another simulator, MuJoCo, with its drag, lift and Magnus force.",
)
