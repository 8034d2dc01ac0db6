"""The limits on what a servo is sent, under random and extreme commands. See test_player.py for whole runs."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.bench.servo.limits import LONGEST_STEP, clamp
from tasks.bench.fabrication.calibration import ServoCalibration


@settings(max_examples=300)
@given(
    pulses=st.lists(st.floats(400, 2600), min_size=3, max_size=3).map(sorted).filter(lambda p: p[2] - p[0] >= 0.5),
    us_per_rad=st.floats(100, 1200),
    max_speed=st.floats(0.001, 50),
    wanted=st.floats() | st.floats(-1000, 5000),
    at=st.floats(0, 1) | st.none(),
    elapsed=st.floats(-1, 10),
)
def test_any_command_stays_within_the_limits(pulses, us_per_rad, max_speed, wanted, at, elapsed):
    low, centre, high = pulses
    limits = {"min_us": low, "max_us": high, "us_per_rad": us_per_rad, "max_speed": max_speed}
    servo = ServoCalibration(joint=1, channel=0, centre_us=centre, direction=1, **limits)
    lowest, highest = math.ceil(4 * low), math.floor(4 * high)
    last = None if at is None else round(lowest + at * (highest - lowest)) / 4
    sent = clamp(wanted, last, elapsed, servo)
    assert low <= sent <= high and sent * 4 == round(sent * 4)
    if last is None:
        assert abs(sent - centre) <= 0.25
    else:
        assert abs(sent - last) <= servo.max_rate_us * min(max(elapsed, 0.0), LONGEST_STEP) + 1e-6


@pytest.mark.parametrize(
    ("wanted", "last", "elapsed", "sent"),
    [  # 2 rad/s · 600 µs/rad · 0.02 s = 24 µs a frame
        (1510.1, 1500.0, 0.02, 1510.0),
        (1510.2, 1500.0, 0.02, 1510.25),
        (1700.0, 1500.0, 0.02, 1524.0),
        (1300.0, 1500.0, 0.02, 1476.0),
        (1700.0, 1500.0, 3600.0, 1548.0),
        (5000.0, 2095.0, 0.02, 2100.0),
        (math.nan, 1510.0, 1.0, 1510.0),
        (math.inf, 1510.0, 0.0, 1510.0),
        (1700.0, None, 1.0, 1500.0),
    ],
)
def test_a_command_is_limited_and_rounded_to_a_quarter_of_a_microsecond(wanted, last, elapsed, sent):
    servo = ServoCalibration(
        joint=1, channel=0, centre_us=1500.0, direction=1, us_per_rad=600.0, min_us=900.0, max_us=2100.0, max_speed=2.0
    )
    assert clamp(wanted, last, elapsed, servo) == sent
