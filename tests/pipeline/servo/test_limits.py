"""The limits on what a servo is sent, under random and extreme commands."""

import math

import numpy as np
import pytest

from pipeline.servo.limits import LONGEST_STEP, LimitedOutput, clamp
from pipeline.servo.servo_controller import DryRunController
from tasks.fabrication.calibration import ServoCalibration


class Recorder(DryRunController):
    def __init__(self) -> None:
        self.sent: list[dict[int, float]] = []

    def send(self, pulses_us) -> None:
        self.sent.append(dict(pulses_us))


def random_servo(rng: np.random.Generator) -> ServoCalibration:
    low, centre, high = np.sort(rng.uniform(400.0, 2600.0, 3)).tolist()
    return ServoCalibration(
        joint=1,
        channel=int(rng.integers(24)),
        centre_us=centre,
        direction=int(rng.choice([-1, 1])),
        us_per_rad=float(rng.uniform(100, 1200)),
        min_us=low,
        max_us=high,
        max_speed=float(rng.uniform(0.001, 50)),
    )


def test_100_000_random_commands_stay_within_the_limits():
    rng = np.random.default_rng(20)
    wild = [math.nan, math.inf, -math.inf, 1e308, -1e308, 0.0, -1.0]
    for _ in range(100):
        servo, recorder, now = random_servo(rng), Recorder(), 0.0
        outlet, before = LimitedOutput(recorder, [servo]), None
        kinds = np.stack([np.zeros(1000), rng.exponential(0.02, 1000), rng.uniform(0, 10, 1000), np.full(1000, -1.0)])
        waits = kinds[rng.integers(4, size=1000), np.arange(1000)]
        asked = np.where(rng.random(1000) < 0.1, rng.choice(wild, 1000), rng.uniform(-1000, 5000, 1000))
        for number, (elapsed, wanted) in enumerate(zip(waits.tolist(), asked.tolist(), strict=True)):
            if number == 500:
                outlet.off()
                before = None
            now += elapsed
            outlet.send({servo.channel: wanted}, now)
            sent = recorder.sent[-1][servo.channel]
            if servo.max_us - servo.min_us >= 0.5:  # a quarter of a microsecond lies between the limits
                assert servo.min_us <= sent <= servo.max_us
            assert sent * 4 == round(sent * 4)
            if before is None:
                assert abs(sent - servo.centre_us) <= 0.25
            else:
                assert abs(sent - before) <= servo.max_rate_us * min(max(elapsed, 0.0), LONGEST_STEP) + 1e-6
            before = sent


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
