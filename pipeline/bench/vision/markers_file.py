"""markers.yaml: which tag is where on the tank, on the bars and on a robot. A throwing kit holds one."""

from collections.abc import Iterator, Sequence
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from tasks.arrays import Bools, Float64
from tasks.bench.fabrication.kit_settings import ThrowingKit
from tasks.bench.fabrication.throwing_bars import ThrowingBar
from tasks.design.genes import MOST_LINKS, N_LINKS
from tasks.parameters import Parameters

Dictionary = Literal["4x4_50", "4x4_250", "5x5_50", "5x5_250", "6x6_250", "apriltag_16h5", "apriltag_36h11"]

_FIRST_BAR_TAG = 4  # of a throwing kit, after those of its tank


class TankTag(Parameters):
    """A tag on the front of the tank."""

    number: int = Field(ge=0)
    """Number of the tag in its dictionary."""
    x: float = Field(ge=-100.0, le=100.0)
    """Centre of the tag, to the right [m]."""
    y: float = Field(ge=-100.0, le=100.0)
    """Centre of the tag, upward from the same origin [m]."""


class TankTags(Parameters):
    """The tank: a rectangle whose corners carry tags."""

    tag_size: float = Field(default=0.04, gt=0.001, le=1.0)
    """Edge of the black square of each tag [m]."""
    corners: tuple[TankTag, ...] = Field(min_length=4)
    """Tags at the corners of the zone in which bars are thrown, upright; further ones improve the calibration."""
    waterline: float = Field(ge=-100.0, le=100.0)
    """Height of the water over the origin of the corners [m]."""

    @model_validator(mode="after")
    def _waterline_is_in_the_zone(self) -> Self:
        heights = [tag.y for tag in self.corners]
        if not min(heights) < self.waterline < max(heights):
            raise ValueError(
                f"waterline is {self.waterline:g}, expected a height between those of the tank's tags, "
                f"{min(heights):g} and {max(heights):g}"
            )
        return self

    def zone_holds(self, points: Float64) -> Bools:
        """Return which of (n, 2) points over the waterline [m] are in the rectangle of the tags."""
        corners = np.array([(tag.x, tag.y - self.waterline) for tag in self.corners])
        inside: Bools = ((points >= corners.min(axis=0)) & (points <= corners.max(axis=0))).all(axis=1)
        return inside


class BarTag(Parameters):
    """A tag on a bar. Its upper edge points along the long axis, toward the bar's end that counts as up."""

    number: int = Field(ge=0)
    """Number of the tag in its dictionary."""
    size: float = Field(gt=0.001, le=1.0)
    """Edge of its black square [m]."""
    along: float = Field(default=0.0, ge=-10.0, le=10.0)
    """Centre of the tag from the bar's centre, along the long axis [m]."""
    across: float = Field(default=0.0, ge=-10.0, le=10.0)
    """Centre of the tag from the bar's centre, along the short axis, to the right where the long axis is up [m]."""


class TaggedBar(Parameters):
    """A bar to throw."""

    length: float = Field(gt=0.001, le=100.0)
    """Long axis [m]."""
    width: float = Field(gt=0.001, le=100.0)
    """Short axis [m]."""
    mass: float = Field(gt=0.0, le=1e6)
    """[kg]"""
    tags: tuple[BarTag, ...] = Field(min_length=1)
    """Its tags; two far apart give the better angle."""


class RobotTags(Parameters):
    """Tags of a built robot: at the centre of each link, upright along its long axis."""

    first: int = Field(default=20, ge=0)
    """Number of the tag of link 0; link 1 has the next one, and so on."""
    n_links: int = Field(default=N_LINKS, ge=2, le=MOST_LINKS)
    """Links of the robot."""
    tag_size: float = Field(default=0.0174, gt=0.001, le=1.0)
    """Edge of the black square of each tag [m]."""

    def bars(self) -> tuple[TaggedBar, ...]:
        """Return the links as bars whose size does not matter, in their order."""
        tags = [BarTag(number=self.first + link, size=self.tag_size) for link in range(self.n_links)]
        return tuple(TaggedBar(length=1.0, width=1.0, mass=1.0, tags=(tag,)) for tag in tags)


class BoardOfMarkers(Parameters):
    """The printed board that calibrates the lens (ChArUco)."""

    columns: int = Field(default=7, ge=3, le=50)
    """Squares along the long side."""
    rows: int = Field(default=5, ge=3, le=50)
    """Squares along the short side."""
    square: float = Field(default=0.036, gt=0.001, le=1.0)
    """Edge of a square [m]."""
    marker: float = Field(default=0.027, gt=0.001, le=1.0)
    """Edge of a tag in a square [m]."""
    first: int = Field(default=30, ge=0)
    """Number of its first tag."""

    @model_validator(mode="after")
    def _tags_fit(self) -> Self:
        if self.marker >= self.square:
            raise ValueError(f"marker is {self.marker:g} m, expected less than square, {self.square:g} m")
        return self

    @property
    def n_tags(self) -> int:
        """Number of its tags, one in every white square."""
        return self.columns * self.rows // 2


class Markers(Parameters):
    """The whole file."""

    dictionary: Dictionary = "4x4_50"
    """Family of the tags, of ArUco or AprilTag."""
    tank: TankTags
    """The tank."""
    bars: tuple[TaggedBar, ...] = ()
    """Bars to throw, in any order."""
    robot: RobotTags = RobotTags()
    """A built robot."""
    board: BoardOfMarkers = BoardOfMarkers()
    """The board."""

    def numbers(self) -> Iterator[int]:
        """Yield the number of every tag on tank, bars and robot."""
        yield from (tag.number for tag in self.tank.corners)
        yield from (tag.number for bar in (*self.bars, *self.robot.bars()) for tag in bar.tags)

    @model_validator(mode="after")
    def _numbers_are_distinct(self) -> Self:
        numbers = list(self.numbers())
        if twice := sorted({number for number in numbers if numbers.count(number) > 1}):
            raise ValueError(f"tag {twice[0]} is on two things: expected a number of its own for each")
        return self


def markers_of(throwing: ThrowingKit, bars: Sequence[ThrowingBar]) -> Markers:
    """Return the markers of a throwing kit's tank and bars."""
    x, y = throwing.tank_length, throwing.tank_height
    corners = tuple(TankTag(number=i, x=at[0], y=at[1]) for i, at in enumerate(((0, 0), (x, 0), (x, y), (0, y))))
    tagged = []
    for i, bar in enumerate(bars):
        size, along = round(bar.tag_mm / 1000, 6), round(bar.tag_at_mm / 1000, 6)
        numbers = ((_FIRST_BAR_TAG + 2 * i, along), (_FIRST_BAR_TAG + 2 * i + 1, -along))
        tags = tuple(BarTag(number=number, size=size, along=at) for number, at in numbers)
        length, width, mass = (round(value / 1000, 6) for value in (bar.length_mm, bar.width_mm, bar.mass_g))
        tagged.append(TaggedBar(length=length, width=width, mass=mass, tags=tags))
    return Markers(tank=TankTags(corners=corners, waterline=throwing.waterline), bars=tuple(tagged))
