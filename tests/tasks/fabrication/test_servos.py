"""The servo library, measurements that replace its dimensions, screw lengths and gauges."""

import re
from dataclasses import fields, replace
from math import pi

import pytest
from build123d import GeomType
from pydantic import ValidationError

from tasks.fabrication.assembly import assemble
from tasks.fabrication.built_bodies import mechanism_of
from tasks.fabrication.checks import findings_of
from tasks.fabrication.features import SCREW_LENGTHS_MM, KitError, ear_screw_mm, horn_screw, horn_seat_mm, plate_mm
from tasks.fabrication.kit import build_kit
from tasks.fabrication.kit_settings import KitSettings
from tasks.fabrication.parts import Gauge, gauges_of, mesh_of
from tasks.fabrication.servo_joints import servo_joints_of, servo_of
from tasks.fabrication.servos import MEASURES, SERVOS, YOURS, Horn, Servo, ServoError, as_measured, servo_named

EVERY_HORN = [(servo.name, horn.kind) for servo in SERVOS.values() for horn in servo.horns]


def test_unknown_servos_and_horns_are_refused_with_the_list():
    with pytest.raises(ServoError, match=r"'sg5010' is unknown, expected one of ds3225, hs85mg, mg90s, pdi6221mg"):
        servo_named("sg5010")
    disc = replace(SERVOS["ds3225"], horns=SERVOS["ds3225"].horns[:1])
    with pytest.raises(ServoError, match="no cross horn, expected disc"):
        disc.horn("cross")


def test_servos_are_what_their_sources_say():
    standard = SERVOS["ds3225"]
    assert standard.stall_torque_nm == pytest.approx(2.059, abs=1e-3)  # 21 kg·cm
    assert standard.no_load_speed_rad_s == pytest.approx(6.981, abs=1e-3)  # 60° in 0.15 s
    paper = SERVOS["pdi6221mg"]
    assert (paper.length_mm, paper.width_mm, paper.height_mm) == (40.5, 20.2, 38.0)  # the standard size
    assert paper.stall_torque_nm == pytest.approx(1.993, abs=1e-3)  # 20.32 kg·cm
    assert paper.no_load_speed_rad_s == pytest.approx(6.545, abs=1e-3)  # 60° in 0.16 s
    assert paper.us_per_rad == pytest.approx(636.6, abs=0.1)  # 2000 µs for 180°
    for servo in SERVOS.values():
        assert servo.min_pulse_us < servo.neutral_us < servo.max_pulse_us
        # The margins depend on these.
        assert {"voltage_v", "stall_torque_nm", "no_load_speed_rad_s", "mass_g"} <= servo.sources.keys()
        assert servo.sources.keys() <= {field.name for field in fields(Servo)}
        for horn in servo.horns:  # the screws are on the horn, clear of the centre screw
            assert horn.sources.keys() <= {field.name for field in fields(Horn)}
            as_measured(servo, horn.kind, {})
            assert servo.centre_screw_mm / 2 < horn.screw_radius_mm - horn.screw_mm / 2
            assert horn.screw_radius_mm + horn.screw_mm / 2 < min(horn.long_mm, horn.short_mm)


def test_fields_without_a_source():
    def missing(item: Servo | Horn) -> set[str]:
        return {field.name for field in fields(item)} - item.sources.keys() - {"name", "kind", "horns", "sources"}

    spline = {"spline_mm", "spline_teeth", "centre_screw_mm", "centre_screw_name"}
    screw = {"centre_screw_mm", "centre_screw_name"}
    assert [missing(servo) for servo in SERVOS.values()] == [set(), spline, screw, screw | {"sense"}]
    (disc, cross), (small, micro), (clone, same), standard = (servo.horns for servo in SERVOS.values())
    assert (missing(disc), missing(cross)) == ({"top_mm", "thickness_mm"}, {"top_mm", "arm_width_mm"})
    assert missing(small) == {"long_mm", "short_mm", "arm_width_mm", "screw_radius_mm"} and missing(clone) == {"top_mm"}
    assert micro is same and not micro.sources
    assert standard == (disc, cross)  # of 25 teeth too


def test_every_measure_is_one_of_a_servo_or_its_horn():
    of_horn, of_servo = ({field.name for field in fields(kind)} for kind in (Horn, Servo))
    assert MEASURES.keys() <= of_horn ^ of_servo  # and never of both


def test_measurements_replace_the_library():
    settings = KitSettings(measured={"length_mm": 40.1, "top_mm": 7.0})
    servo = servo_of(settings)
    assert (servo.length_mm, servo.width_mm, servo.horns[0].top_mm) == (40.1, 20.0, 7.0)
    assert servo.sources["length_mm"] == servo.sources["top_mm"] == YOURS != servo.sources["height_mm"]
    assert servo.sources["hub_mm"] == servo.horns[0].sources["hub_mm"] and "thickness_mm" not in servo.sources
    with pytest.raises(ValidationError, match="got lenght_mm"):
        KitSettings(measured={"lenght_mm": 40.1})
    with pytest.raises(ServoError, match=r"ds3225: length_mm is 50, expected less than hole_span_mm, 49\.5"):
        servo_of(KitSettings(measured={"length_mm": 50.0}))
    with pytest.raises(ServoError, match=r"ear_bottom_mm \+ ear_thickness_mm is 41\.5, expected less than h.*, 40\.5"):
        servo_of(KitSettings(measured={"ear_bottom_mm": 39.0}))


@pytest.mark.parametrize(
    ("horn", "measured", "said"),
    [
        *(("disc", {name: 0.0}, f"{name} is 0, expected more than 0") for name in MEASURES if name != "hole_pitch_mm"),
        ("disc", {"hub_mm": 14.0}, "hub_mm is 14, expected less than 2 * screw_radius_mm, 14"),
        ("disc", {"screw_radius_mm": 3.0}, "hub_mm is 9, expected less than 2 * screw_radius_mm, 6"),
        ("disc", {"cable_width_mm": 25.0}, "cable_width_mm is 25, expected less than width_mm, 20"),
        ("disc", {"long_mm": 12.0}, "short_mm of its disc is 10, expected long_mm, 12"),
        ("disc", {"arm_width_mm": 5.0}, "arm_width_mm of its disc is 5, expected 2 * long_mm, 20"),
        ("cross", {"hub_mm": 500.0}, "hub_mm is 500, expected less than 2 * screw_radius_mm, 20.8"),
        ("cross", {"arm_width_mm": 40.0}, "arm_width_mm is 40, expected less than 2 * short_mm, 36"),
        ("cross", {"arm_width_mm": 40.0, "short_mm": 21.0}, "arm_width_mm is 40, expected less than 2 * long_mm, 36"),
    ],
)
def test_impossible_measurements_are_refused(horn, measured, said):
    with pytest.raises(ServoError, match=re.escape(f"servo ds3225: {said}")):
        servo_of(KitSettings(horn=horn, measured=measured))


def test_a_disc_of_another_size_is_accepted():
    larger = {"long_mm": 10.2, "short_mm": 10.2, "arm_width_mm": 20.4, "hole_pitch_mm": 0.0}
    assert servo_of(KitSettings(measured=larger)).horns[0].long_mm == 10.2


def test_dimensions_without_a_source_are_reported(crane):
    mechanism = mechanism_of(crane, KitSettings())

    def said(settings: KitSettings) -> list[str]:
        findings = findings_of(assemble(crane, settings))
        return [finding.message for finding in findings if finding.name == "not measured"]

    (servo_joint, _) = servo_joints_of(mechanism, KitSettings())
    unknown = [name for name in MEASURES if name not in servo_joint.servo.sources]
    (message,) = said(KitSettings())
    assert message.startswith(f"{len(unknown)} of {len(MEASURES)} dimensions of a ds3225 and its disc horn")
    values = {
        name: getattr(servo_joint.horn if hasattr(servo_joint.horn, name) else servo_joint.servo, name)
        for name in unknown
    }
    assert said(KitSettings(measured=values)) == []


@pytest.mark.parametrize(("servo", "horn"), EVERY_HORN)
def test_screws_reach_and_hold(crane, servo, horn):
    for thickness in (17.0, 25.0, 40.0):
        settings = KitSettings(servo=servo, horn=horn, thickness_mm=thickness)
        (servo_joint, _) = servo_joints_of(mechanism_of(crane, settings), settings)
        screw = horn_screw(servo_joint, settings)
        beyond = screw.length_mm - screw.web_mm
        assert screw.length_mm in SCREW_LENGTHS_MM and screw.web_mm >= 5.0
        assert screw.web_mm <= horn_seat_mm(servo_joint, settings)
        # It protrudes from the horn, whose whole thickness holds it, and stays clear of the case.
        assert servo_joint.horn.thickness_mm < beyond < servo_joint.horn.top_mm
        assert screw.engaged_mm == servo_joint.horn.thickness_mm
        ear = ear_screw_mm(servo_joint)
        assert servo_joint.servo.ear_screw_mm <= ear - servo_joint.servo.ear_thickness_mm <= plate_mm(servo_joint)


@pytest.mark.parametrize(("servo", "horn"), EVERY_HORN)
def test_parts_and_gauges_of_every_servo_are_solids(crane, servo, horn):
    kit = build_kit(crane, KitSettings(servo=servo, horn=horn))
    assert {part.body for part in kit.parts} == set(range(len(kit.mechanism.bodies)))
    for printed in (*kit.parts, *kit.gauges):
        assert printed.solid.is_valid and printed.solid.volume == pytest.approx(printed.volume_mm3, rel=1e-6)
    # The case fits its gauge, and its ears lie on the plate.
    case, rim = kit.servo_joints[0].servo, kit.gauges[0].solid.bounding_box()
    assert max(rim.size.X, rim.size.Y) > case.ear_length_mm and min(rim.size.X, rim.size.Y) > case.width_mm
    plate = case.height_mm - case.ear_bottom_mm - case.ear_thickness_mm
    height_mm = rim.size.Z
    assert height_mm == pytest.approx(plate + 3.0)  # and 3 mm of the pocket's rim


def test_short_threads_and_missing_screw_lengths(crane, kit):
    (said,) = (finding for finding in kit.findings if finding.name == "short thread")
    assert said.severity == "warning"
    assert (
        "the M3 screws in the disc horn engage 2.5 mm of thread, expected at least their diameter, 3 mm" in said.message
    )
    thick = KitSettings(measured={"thickness_mm": 3.0})
    assert not any(finding.name == "short thread" for finding in findings_of(assemble(crane, thick)))
    settings = KitSettings(measured={"thickness_mm": 7.2})  # 0.3 mm to the case
    (servo_joint, _) = servo_joints_of(mechanism_of(crane, settings), settings)
    with pytest.raises(KitError, match=r"no screw of 4 to 60 mm holds a disc horn 7\.2 mm thick .* 7\.5 mm above"):
        horn_screw(servo_joint, settings)


def test_gauges_are_slices_of_the_parts(crane):
    settings = KitSettings()
    servo, horn = gauges_of(servo_joints_of(mechanism_of(crane, settings), settings), settings)
    assert [servo.name, horn.name] == ["gauge-servo", "gauge-horn"]
    # The plate of 40.5 - 28 - 2.5 = 10 mm and 3 mm of the pocket's rim; the boss is the pocket's with 3 mm of wall.
    boss = 60.6 * 26.6 - (4 - pi) * 3.0**2
    assert servo.volume_mm3 == pytest.approx(
        13 * boss - 3 * 54.6 * 20.6 - 10 * (40.6 * 20.6 + 4 * pi * 1.275**2), rel=1e-9
    )
    # The recess of 6.5 mm and the web of 5.
    assert horn.volume_mm3 == pytest.approx(
        11.5 * pi * 13.3**2 - 6.5 * pi * 10.3**2 - 5 * pi * (3.5**2 + 4 * 1.7**2), rel=1e-9
    )
    for gauge, opening in ((servo, 54.6 * 20.6), (horn, pi * 10.3**2)):
        box, mesh = gauge.solid.bounding_box(), mesh_of(gauge.solid)
        assert abs(box.min.Z) < 1e-6
        planes = [face for face in gauge.solid.faces() if face.geom_type == GeomType.PLANE]
        (rim,) = (face for face in planes if abs(face.center().Z - box.max.Z) < 1e-6)
        whole = boss if gauge is servo else pi * 13.3**2
        assert rim.area == pytest.approx(whole - opening, rel=1e-6)  # it opens upward
        assert len(mesh.triangles) > 50
    assert gauges_of((), settings) == ()


@pytest.mark.parametrize(("servo", "horn"), EVERY_HORN)
def test_the_gap_between_the_gauges_is_the_layer_gap(crane, servo, horn):
    """The ears lie on one gauge's plate, the horn on the floor of the other: docs/assembly.md, "Measure first"."""
    settings = KitSettings(servo=servo, horn=horn)
    (servo_joint, *_) = servo_joints_of(mechanism_of(crane, settings), settings)

    def floors(gauge: Gauge) -> list[float]:
        """Return the heights of the horizontal faces, from the lowest to the rim."""
        planes = [face for face in gauge.solid.faces() if face.geom_type == GeomType.PLANE]
        return sorted({round(face.center().Z, 6) for face in planes if abs(face.normal_at().Z) > 0.5})

    plate, recess = (floors(gauge) for gauge in gauges_of((servo_joint,), settings))
    case = servo_joint.servo
    to_the_ears = case.height_mm - case.ear_bottom_mm - case.ear_thickness_mm
    (below, ears, _) = plate
    assert ears - below == pytest.approx(to_the_ears)  # so the case's top is flush
    (_, floor, rim) = recess
    gap = servo_joint.horn.top_mm - (rim - floor)
    assert gap == pytest.approx(settings.layer_gap_mm)
