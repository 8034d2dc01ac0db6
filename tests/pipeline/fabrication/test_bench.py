"""Findings about the bench for numbers chosen by hand."""

import numpy as np
import pytest

from pipeline.config.loading import parse
from pipeline.fabrication.bench_checks import (
    check_floating,
    check_loads,
    check_predictions,
    check_scale,
    check_timeline,
)
from pipeline.fabrication.kit_page import worst_of_each
from tasks.analysis.tank import Tank
from tasks.fabrication.calibration import Calibration, ServoCalibration
from tasks.fabrication.floating import Floating
from tasks.fabrication.kit_settings import FabricationSettings
from tasks.fabrication.scaling import JointLoad
from tasks.fabrication.servos import servo_named
from tasks.fabrication.timeline import Timeline


def lying(draught: float | None, share: float = 0.5) -> Floating:
    return Floating(
        mass_kg=1.0, sealed_m3=2e-3, sealed_share=share, flooded_share=0.7, draught_mm=draught, height_mm=400.0
    )


def test_floating():
    (found,) = check_floating(lying(289.0), 150.0)
    assert found.severity == "warning"
    assert found.message == "stands on the floor of a 150 mm deep tank: its draught is 289 mm"
    assert check_floating(lying(149.0), 150.0) == []
    (sinks,) = check_floating(lying(None, 1.2), 150.0)
    assert "sinks" in sinks.message


@pytest.mark.parametrize(("saturated", "severity"), [(0.21, "warning"), (0.19, "note"), (0.04, None)])
def test_clipped_torque_is_a_lower_bound(saturated, severity):
    load = JointLoad(
        joint=2, peak_torque=0.1, rms_torque=0.1, peak_speed=1.0, use=0.5, stall_share=0.1, saturated=saturated
    )
    found = check_loads([load], servo_named("ds3225"), FabricationSettings())
    assert [one.severity for one in found] == ([severity] if severity else [])
    assert ("lower bound" in "".join(one.message for one in found)) == (severity == "warning")


def test_a_kit_and_a_tank_of_different_scales():
    assert check_scale(None, 100.0) == check_scale(Tank(), 70.0) == []
    (found,) = check_scale(Tank(), 100.0)
    assert found.severity == "warning" and "100 mm" in found.message and "kit.scale_mm_per_m=70" in found.message


def test_few_points_show_the_worst_of_a_run():
    use = np.array([0.1, 0.3, 0.2, 0.5, 0.4, 0.4, 0.9])
    assert worst_of_each(use, 3).tolist() == [1, 3, 6]
    assert worst_of_each(use, 1).tolist() == list(range(7))


def chosen(*overrides: str) -> FabricationSettings:
    return parse(FabricationSettings, "", name="the kit's settings", overrides=overrides)


def asked(*, torque: float, speed: float, use: float) -> JointLoad:
    return JointLoad(
        joint=2, peak_torque=torque, rms_torque=0.1, peak_speed=speed, use=use, stall_share=0.1, saturated=0.0
    )


STALL, FASTEST = servo_named("ds3225").stall_torque_nm, servo_named("ds3225").no_load_speed_rad_s
SLOWER, STRONGER = ("choose a faster servo", "kept_frequencies"), ("choose a stronger servo", "servos_per_joint=2")
MANY = ("scaling.law=kept_frequencies", "kit.servos_per_joint=2")


@pytest.mark.parametrize(
    ("load", "overrides", "said", "unsaid"),
    [
        (asked(torque=0.1, speed=1.1 * FASTEST, use=1.1), (), SLOWER, STRONGER),
        (asked(torque=1.2 * STALL, speed=1.0, use=1.3), (), STRONGER, SLOWER),
        (asked(torque=0.6 * STALL, speed=0.6 * FASTEST, use=1.2), (), (*SLOWER, *STRONGER), ()),
        # A choice already made is no advice.
        (
            asked(torque=1.2 * STALL, speed=1.1 * FASTEST, use=2.3),
            MANY,
            (SLOWER[0], STRONGER[0]),
            (SLOWER[1], STRONGER[1]),
        ),
    ],
)
def test_advice_depends_on_the_shortfall(load, overrides, said, unsaid):
    (found,) = check_loads([load], servo_named("ds3225"), chosen(*overrides))
    assert found.severity == "fault" and "too weak or too slow" in found.message
    assert all(words in found.message for words in said) and not any(words in found.message for words in unsaid)


@pytest.mark.parametrize(("use", "severity"), [(1.01, "fault"), (1.0, "warning"), (0.8, "warning"), (0.75, None)])
def test_a_small_margin_is_a_warning(use, severity):
    found = check_loads([asked(torque=use * STALL, speed=1.0, use=use)], servo_named("ds3225"), chosen())
    assert [one.severity for one in found] == ([severity] if severity else [])
    if severity == "warning":
        assert f"{1 / use:.2f} times" in found[0].message and "stronger" in found[0].message


def test_heat_is_reported_as_a_root_mean_square():
    load = JointLoad(joint=2, peak_torque=0.1, rms_torque=0.1, peak_speed=1.0, use=0.5, stall_share=0.4, saturated=0.0)
    (found,) = check_loads([load], servo_named("ds3225"), chosen())
    assert found.name == "heat" and "root mean square" in found.message and "average" not in found.message


@pytest.mark.parametrize(
    ("degrees", "hz", "said", "unsaid"),
    [
        (90.0, 0.1, "more travel", "faster"),  # 1.0 rad/s
        (50.0, 2.0, "faster", "more travel"),  # 11 rad/s
        (90.0, 2.0, "more travel", "stronger"),
    ],
)
def test_a_timeline_that_is_refused(degrees, hz, said, unsaid):
    servo = ServoCalibration(
        joint=2, channel=0, centre_us=1500.0, direction=1, us_per_rad=570.0, min_us=903.0, max_us=2097.0, max_speed=7.0
    )
    swing = np.radians(degrees) * np.sin(2 * np.pi * hz * np.arange(500) / 50)
    (found,) = check_timeline(Timeline((2,), swing[:, None]), Calibration(servos=(servo,)), chosen())
    assert found.severity == "fault" and said in found.message and unsaid not in found.message
    assert ".." not in found.message.replace("...", "")
    assert check_timeline(Timeline((2,), swing[:, None] / 10), Calibration(servos=(servo,)), chosen()) == []


@pytest.mark.parametrize(
    ("displacement", "truth", "said"),
    [
        ((3.0, -1.0), None, ["disagree"]),  # 1 ± 2
        ((3.0, 5.0), 5.5, []),  # 4 ± 1, 1.5 σ off
        ((3.0, 5.0), 6.5, ["2 σ away"]),
        ((3.0, 5.0), None, []),
    ],
)
def test_an_ensemble_in_doubt(displacement, truth, said):
    found = check_predictions(displacement, truth)
    assert len(found) == len(said) and all(words in one.message for words, one in zip(said, found, strict=True))
