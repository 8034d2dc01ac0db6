"""Settings of ``puddle fabricate``. [P] marks values from the paper; lengths are in mm."""

from typing import Annotated, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, field_validator

from tasks.bench.fabrication.scaling import Scaling
from tasks.bench.fabrication.servos import DIMENSIONS, HornKind
from tasks.parameters import Parameters


class KitSettings(Parameters):
    """Settings that turn a design into printed parts."""

    scale_mm_per_m: float = Field(default=70.0, ge=10.0, le=1000.0)
    """Bench millimetres per metre of simulation. [P]"""
    thickness_mm: float = Field(default=25.0, ge=15.0, le=100.0)
    """Thickness of every part. [P]"""
    pitch_mm: float = Field(default=300.0, ge=150.0, le=1000.0)
    """Distance from one pontoon to the other. [P]"""
    servo: str = "ds3225"
    """Name in the servo library. The paper's servo has 20 kg·cm, as the pdi6221mg."""
    horn: HornKind = "disc"
    """Kind of horn."""
    measured: dict[str, NonNegativeFloat] = Field(default_factory=dict)
    """Caliper readings that replace the library's dimensions, such as {length_mm: 40.1}; a kit's page lists them."""
    servos_per_joint: Literal[1, 2] = 1
    """1: a servo in one pontoon, a pin in the other, which the rods take along [P]; 2: a servo in each."""
    layer_gap_mm: float = Field(default=1.0, ge=0.3, le=5.0)
    """Gap between the two layers of a pontoon."""
    servo_clearance_mm: float = Field(default=0.3, ge=0.0, le=2.0)
    """Clearance on every side of a servo or horn; printed pockets come out small."""
    rod_mm: float = Field(default=3.0, ge=1.0, le=10.0)
    """Diameter of the rods. [P]"""
    bed_mm: tuple[PositiveFloat, PositiveFloat, PositiveFloat] = (220.0, 220.0, 250.0)
    """Width, depth and height of the printer. Larger parts are split by dovetails."""
    infill: float = Field(default=0.45, gt=0.0, le=1.0)
    """Share of the interior that is printed. [P]"""

    @field_validator("measured")
    @classmethod
    def _check_names(cls, measured: dict[str, float]) -> dict[str, float]:
        if unknown := sorted(measured.keys() - DIMENSIONS.keys()):
            raise ValueError(f"expected names of {', '.join(DIMENSIONS)}; got {', '.join(unknown)}")
        return measured

    @property
    def pin_length_mm(self) -> float:
        """Length of a pin: both layers and the gap."""
        return 2 * self.thickness_mm + self.layer_gap_mm


class ThrowingKit(Parameters):
    """Settings of a kit of bars to throw, with the tank that they are thrown into."""

    lengths: tuple[Annotated[float, Field(ge=0.1, le=10.0)], ...] = Field(default=(1.0, 1.5, 2.0, 3.0), min_length=3)
    """Long axes of the simulated links [m]; robots have 1 to 3 m."""
    density_ratio: float = Field(default=0.8, gt=0.0, le=10.0)
    """Density of a bar over that of the fluid; a link of 1 kg/m² floats in slush of 1.25."""
    tank_length: float = Field(default=1.17, gt=0.0, le=100.0)
    """From tag to tag along the front of the tank, between centres [m]; the paper's tank. [P]"""
    tank_height: float = Field(default=0.27, gt=0.0, le=100.0)
    """From tag to tag upward, between centres [m]. [P]"""
    waterline: float = Field(default=0.15, ge=-100.0, le=100.0)
    """Height of the water over the centres of the lower tags [m]. [P]"""


class FabricationSettings(Parameters):
    """Settings of a kit, separate from a study's."""

    kit: KitSettings = KitSettings()
    """Parts, servo and printer."""
    scaling: Scaling = Scaling()
    """Scaling from simulation to bench."""
    throwing: ThrowingKit = ThrowingKit()
    """Bars to throw, for `puddle fabricate --throwing-kit`."""
