"""Conventions of a tracks file: which file, and what its numbers mean."""

from typing import Literal

from pydantic import Field

from tasks.parameters import Parameters
from tasks.world import froude_time


class Tracks(Parameters):
    """Tracked throws of bars, which networks learn from in place of simulated throws."""

    file: str = Field(min_length=1)
    """CSV or Parquet file with the columns throw, time [s], x, y, angle. A relative path is relative to the folder
    where the command is run; the study's record has the whole path."""
    bars: str | None = None
    """File with the columns throw, length, width, mass [kg]; null if the tracks have them, or for NAME-bars.csv beside
    them."""
    sha256: str | None = Field(default=None, pattern="^[0-9a-f]{64}$")
    """SHA-256 of the tracks. The command line adds it, and refuses a file with another one."""
    bars_sha256: str | None = Field(default=None, pattern="^[0-9a-f]{64}$")
    """SHA-256 of the file of bars, added likewise."""
    metres_per_metre: float = Field(default=0.07, gt=0.0, le=10.0)
    """Bench metres per metre of simulation, as in fabrication; times follow by Froude's law. [P]"""
    length_unit: Literal["m", "mm"] = "m"
    """Unit of x, y, lengths and widths."""
    angle_unit: Literal["rad", "deg"] = "rad"
    """Unit of angles, which are 0 where the long axis is upright and grow anticlockwise."""
    flip_x: bool = False
    """Whether x grows to the left."""
    flip_y: bool = False
    """Whether y grows downward, as pixels do."""
    flip_angle: bool = False
    """Whether angles grow clockwise. A mirrored view flips x and the angle; an image whose y grows downward, y and the
    angle."""

    @property
    def simulated_unit(self) -> float:
        """The file's unit of length [m of simulation]."""
        return (1e-3 if self.length_unit == "mm" else 1.0) / self.metres_per_metre

    @property
    def time_scale(self) -> float:
        """The file's seconds per second of simulation."""
        return froude_time(self.metres_per_metre)
