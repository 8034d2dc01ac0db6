"""The source of a kit's design, and how it is simulated."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pipeline.config.settings import Settings
from pipeline.stages.data_sets import NetworkId
from pipeline.store.design_file import load_design
from pipeline.workflow.stage import Files
from tasks.design import Designs
from tasks.world import Physics

_PHYSICAL_DEPTH = 2.0  # of the slush in which a design file is simulated [m]; paper, "Physical Validation"


def as_built(physics: Physics) -> Physics:
    """Return the physics of a kit: joints without a motor are locked, and links collide."""
    return physics.model_copy(update={"passive_joints": "locked", "link_collisions": True})


@dataclass(frozen=True, eq=False)
class DesignSource:
    """A design and its origin."""

    design: Designs
    name: str
    origin: str  # where the design comes from, in words
    settings: Settings  # settings of the study, or those for simulating a design file
    depth: float  # depth of the slush in the simulation [m]
    predicted: tuple[float, ...] | None
    """(n_members) displacements that the study's ensemble predicts of the robot as built [m of simulation], if any."""
    networks: Mapping[NetworkId, Files] = field(default_factory=dict)  # of a learned target

    @property
    def environment(self) -> str:
        """Environment of the simulation, in words."""
        return f"{self.settings.target_label} at {self.depth:g} m"

    @property
    def prediction(self) -> tuple[float, float] | None:
        """Mean and standard deviation of ``predicted`` [m of simulation]."""
        return None if self.predicted is None else (float(np.mean(self.predicted)), float(np.std(self.predicted)))


def from_file(path: Path, settings: Settings) -> DesignSource:
    """Read a design file, to be simulated with some settings. Raises PuddleError if it is invalid."""
    where = f"{settings.target_label} at {_PHYSICAL_DEPTH:g} m"
    origin = f"Design file {path.name}, simulated in {where} with the settings of {settings.name}."
    return DesignSource(load_design(path), path.stem, origin, settings, _PHYSICAL_DEPTH, None)
