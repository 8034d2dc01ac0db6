"""What a kit's bench is warned of, against numbers chosen by hand."""

import pytest

from pipeline.fabrication.bench import Members, _of_floating, _of_loads, _of_members
from tasks.fabrication.floating import Floating
from tasks.fabrication.scaling import JointLoad
from tasks.fabrication.servos import servo_named


def lying(draught: float | None, share: float = 0.5) -> Floating:
    return Floating(mass_kg=1.0, sealed_m3=2e-3, flooded_m3=1.5e-3, sealed_share=share, flooded_share=0.7,
                    draught_mm=draught, height_mm=400.0)  # fmt: skip


def test_a_robot_that_stands_on_the_floor():
    (found,) = _of_floating(lying(289.0), 150.0)
    assert found.severity == "warning"
    assert found.message == "it stands on the floor of a tank of 150 mm: its draught is 289 mm"
    assert _of_floating(lying(149.0), 150.0) == []
    (sinks,) = _of_floating(lying(None, 1.2), 150.0)
    assert "it sinks" in sinks.message


@pytest.mark.parametrize(("saturated", "severity"), [(0.21, "warning"), (0.19, "note"), (0.04, None)])
def test_torque_that_was_clipped_is_a_lower_bound(saturated, severity):
    load = JointLoad(joint=2, peak_torque=0.1, rms_torque=0.1, peak_speed=1.0, use=0.5, stall_share=0.1,
                     saturated=saturated)  # fmt: skip
    found = _of_loads([load], servo_named("ds3225"), object())
    assert [one.severity for one in found] == ([severity] if severity else [])
    assert ("lower bound" in "".join(one.message for one in found)) == (severity == "warning")


@pytest.mark.parametrize(
    ("displacement", "truth", "said"),
    [
        ((3.0, -1.0), None, ["do not agree"]),  # 1 ± 2
        ((3.0, 5.0), 5.5, []),  # 4 ± 1, 1.5 σ off
        ((3.0, 5.0), 6.5, ["2 σ off"]),
        ((3.0, 5.0), None, []),
    ],
)
def test_an_ensemble_in_doubt(displacement, truth, said):
    found = _of_members(Members(displacement), truth)
    assert len(found) == len(said) and all(words in one.message for words, one in zip(said, found, strict=True))
