"""The servo library, measurements that replace its dimensions, screw lengths and gauges."""

import pytest
from build123d import GeomType
from pydantic import ValidationError

from tasks.bench.fabrication.built_bodies import mechanism_of
from tasks.bench.fabrication.kit_error import KitError
from tasks.bench.fabrication.kit_settings import KitSettings
from tasks.bench.fabrication.parts import Gauge, gauges_of
from tasks.bench.fabrication.servo_joints import servo_joints_of
from tasks.bench.fabrication.servos import SERVOS, as_measured

pytestmark = pytest.mark.slow

EVERY_HORN = [(servo.name, horn.kind) for servo in SERVOS.values() for horn in servo.horns]


def test_measurements_replace_the_library():
    servo = as_measured("ds3225", "disc", {"length_mm": 40.1, "top_mm": 7.0, "hole_pitch_mm": 0.0})
    assert (servo.length_mm, servo.width_mm, servo.horns[0].top_mm, servo.hole_pitch_mm) == (40.1, 20.0, 7.0, 0.0)
    with pytest.raises(ValidationError, match="got lenght_mm"):
        KitSettings(measured={"lenght_mm": 40.1})
    for name, measured, said in (
        ("sg5010", {}, r"'sg5010' is unknown, expected one of ds3225, hs85mg, mg90s, pdi6221mg"),
        ("ds3225", {"length_mm": 401}, r"length_mm is 401, expected 20 to 80 mm"),
        ("ds3225", {"hole_span_mm": 30}, "expected length_mm < hole_span_mm < ear_length_mm, got 40, 30"),
        ("ds3225", {"top_mm": 0}, r"top_mm is 0, expected 3\.75 to 15 mm"),
    ):
        with pytest.raises(KitError, match=said):
            as_measured(name, "disc", measured)


def floors(gauge: Gauge) -> list[float]:
    """Return the heights of the horizontal faces, from the lowest to the rim."""
    planes = [face for face in gauge.solid.faces() if face.geom_type == GeomType.PLANE]
    return sorted({round(face.center().Z, 6) for face in planes if abs(face.normal_at().Z) > 0.5})


@pytest.mark.parametrize(("servo", "horn"), EVERY_HORN)
def test_the_gauges_of_every_servo(crane, servo, horn):
    settings, case = KitSettings(servo=servo, horn=horn), as_measured(servo, horn, {})
    gauges = gauges_of(servo_joints_of(mechanism_of(crane, settings), case, settings))
    # The ears lie on one gauge's plate, so that the case's top is flush; the horn lies on the floor of the other. The
    # gap between both is that of the layers.
    plate, recess = map(floors, gauges)
    assert plate[1] - plate[0] == pytest.approx(case.height_mm - case.ear_bottom_mm - case.ear_thickness_mm)
    assert plate[2] - plate[1] == pytest.approx(3.0)  # of the pocket's rim
    assert case.horns[0].top_mm - (recess[2] - recess[1]) == pytest.approx(settings.layer_gap_mm)
