"""Bars: what they are in the simulation, and what is refused."""

import re
from dataclasses import replace

import numpy as np
import pytest

from tasks.bench.tracks import Bars, TrackError, Tracks
from tasks.bench.tracks.bars import length_scales

BARS = Bars(np.array([3, 7]), np.array([0.07, 0.14]), np.array([0.07, 0.035]), np.array([0.1, 0.1]))
PLAIN = Tracks(file="tracks.csv")


def test_a_link_has_an_area_of_a_square_metre() -> None:
    assert length_scales(BARS, PLAIN) == pytest.approx({"3": 1.0, "7": 2.0})
    in_mm = replace(BARS, length=1000 * BARS.length, width=1000 * BARS.width)
    assert length_scales(in_mm, Tracks(file="tracks.csv", length_unit="mm")) == pytest.approx({"3": 1.0, "7": 2.0})
    unscaled = replace(BARS, length=np.array([1.0, 2.0]), width=np.array([1.0, 0.5]))
    assert length_scales(unscaled, Tracks(file="tracks.csv", metres_per_metre=1.0)) == {"3": 1.0, "7": 2.0}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"length": [70.0, 0.14]},
            "throw 3: the bar's length is 70 m, or 1e+03 m of simulation: expected 1 to 3 m of simulation, which is "
            "0.07 to 0.21 m: check tracks.length_unit (m or mm) and tracks.metres_per_metre",
        ),
        ({"length": [0.07, np.nan]}, "throw 7: the bar's length is nan, expected a number above 0"),
        ({"mass": [0.1, 0.0]}, "throw 7: the bar's mass is 0, expected a number above 0"),
        ({"width": [0.07, 0.07]}, "throw 7: the bar is 0.14 by 0.07 m: expected a width of 0.035 m"),
        ({"mass": [0.1, 50.0]}, "the bar of throw 3 has a mass of 0.1 kg and that of throw 7 one of 50 kg"),
        ({"throw": [7, 7]}, "throw 7 has 2 bars, expected one"),
    ],
)
def test_what_is_no_link_is_refused(changes, message: str) -> None:
    changed = replace(BARS, **{name: np.array(column) for name, column in changes.items()})
    with pytest.raises(TrackError, match=re.escape(message)):
        length_scales(changed, PLAIN)
