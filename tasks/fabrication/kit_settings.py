"""What may be chosen of a kit: scale, servo, clearances, printer. [P] marks what the paper says of the robot it built.

Millimetres, as everywhere in fabrication.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, field_validator

from tasks.fabrication.servos import MEASURES, HornKind
from tasks.parameters import Parameters


class KitSettings(Parameters):
    """From a design to printed parts."""

    scale_mm_per_m: float = Field(default=70.0, ge=10.0, le=1000.0)
    """Bench millimetres for a metre of simulation. [P]"""
    thickness_mm: float = Field(default=25.0, ge=15.0, le=100.0)
    """Of every part, along the extrusion. [P]"""
    pitch_mm: float = Field(default=300.0, ge=150.0, le=1000.0)
    """From one pontoon to the other, along the extrusion. [P]"""
    servo: str = "ds3225"
    """Name in the library of servos. [P] has one of 20 kg·cm, as the pdi6221mg is."""
    horn: HornKind = "disc"
    """Which of the servo's horns is used."""
    measured: dict[str, NonNegativeFloat] = Field(default_factory=dict)
    """What a caliper says of your servo and horn, in place of the library's: {length_mm: 40.1}. A kit's page lists the
    names, and what it took for the others."""
    servos_per_joint: Literal[1, 2] = 1
    """1: one pontoon is driven at a joint and the rods take the other along, on a pin [P]; 2: both are driven."""
    layer_gap_mm: float = Field(default=1.0, ge=0.3, le=5.0)
    """Between the two layers in which joined parts pass one another."""
    servo_clearance_mm: float = Field(default=0.3, ge=0.0, le=2.0)
    """On every side of a servo or horn in its pocket; printed pockets come out small."""
    rod_mm: float = Field(default=3.0, ge=1.0, le=10.0)
    """Diameter of the rods. [P]"""
    rods_per_part: int = Field(default=2, ge=1, le=4)
    """Rods that tie a part to its copy in the other pontoon; two stop them from twisting."""
    rod_clearance_mm: float = Field(default=0.1, ge=0.0, le=1.0)
    """Added to a rod's diameter where it is held (glued or pressed)."""
    pivot_clearance_mm: float = Field(default=0.3, ge=0.05, le=1.0)
    """Added to a pin's diameter where a part turns on it."""
    sweep_clearance_mm: float = Field(default=1.0, ge=0.0, le=10.0)
    """Between a moving part and anything that it may not touch."""
    wall_mm: float = Field(default=3.0, ge=0.8, le=10.0)
    """Of a boss around a servo, a horn or a rod."""
    min_wall_mm: float = Field(default=1.2, ge=0.4, le=5.0)
    """Thinnest wall that prints well: three lines of a 0.4 mm nozzle. Anything thinner is a fault."""
    min_neck_mm: float = Field(default=8.0, ge=0.0, le=50.0)
    """Narrowest place of a part's outline that is thought strong enough."""
    fillet_mm: float = Field(default=5.0, ge=0.0, le=20.0)
    """Radius in the inner corners of an outline, where links meet; less where it does not fit."""
    bed_mm: tuple[PositiveFloat, PositiveFloat, PositiveFloat] = (220.0, 220.0, 250.0)
    """Printer's width, depth and height. A larger part is split by a dovetail."""
    bed_margin_mm: float = Field(default=5.0, ge=0.0, le=50.0)
    """Kept free along the edges of the bed."""
    split_clearance_mm: float = Field(default=0.2, ge=0.0, le=1.0)
    """Between the two sides of a dovetail."""
    infill: float = Field(default=0.45, gt=0.0, le=1.0)
    """Share of the inside that is printed. [P]"""
    shell_mm: float = Field(default=0.8, ge=0.0, le=5.0)
    """Of solid plastic along every surface: two lines of a 0.4 mm nozzle."""
    pla_density_g_cm3: float = Field(default=1.24, gt=0.5, le=3.0)
    """Of PLA."""
    steel_density_g_cm3: float = Field(default=7.9, gt=1.0, le=20.0)
    """Of stainless steel rods."""

    @field_validator("measured")
    @classmethod
    def _known(cls, measured: dict[str, float]) -> dict[str, float]:
        if strangers := sorted(measured.keys() - MEASURES.keys()):
            raise ValueError(f"expected names of {', '.join(MEASURES)}; came {', '.join(strangers)}")
        return measured
