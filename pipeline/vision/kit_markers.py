"""The markers file of a throwing kit."""

from collections.abc import Sequence

from pipeline.vision.markers_file import BarTag, Markers, TaggedBar, TankTag, TankTags
from tasks.fabrication.kit_settings import ThrowingKit
from tasks.fabrication.throwing_bars import ThrowingBar

_FIRST_BAR_TAG = 4  # after those of the tank


def markers_of(throwing: ThrowingKit, bars: Sequence[ThrowingBar]) -> Markers:
    """Return the markers of tank and bars: each tag's number and place."""
    x, y = throwing.tank_length, throwing.tank_height
    corners = tuple(TankTag(number=i, x=at[0], y=at[1]) for i, at in enumerate(((0, 0), (x, 0), (x, y), (0, y))))
    tagged = []
    for i, bar in enumerate(bars):
        size, along = round(bar.tag_mm / 1000, 6), round(bar.tag_at_mm / 1000, 6)
        tags = (
            BarTag(number=_FIRST_BAR_TAG + 2 * i, size=size, along=along),
            BarTag(number=_FIRST_BAR_TAG + 2 * i + 1, size=size, along=-along),
        )
        sides = (round(bar.length_mm / 1000, 6), round(bar.width_mm / 1000, 6))
        tagged.append(TaggedBar(length=sides[0], width=sides[1], mass=round(bar.mass_g / 1000, 6), tags=tags))
    return Markers(tank=TankTags(corners=corners, waterline=throwing.waterline), bars=tuple(tagged))
