"""Findings about the bench for numbers chosen by hand."""

import numpy as np
import pytest
import shapely

from pipeline.bench.fabrication.bench import bench_of, check_floating, check_loads
from pipeline.bench.fabrication.source import DesignSource, as_built
from tasks.bench.fabrication.kit import Floating, floating_of
from tasks.bench.fabrication.kit_settings import FabricationSettings
from tasks.bench.fabrication.scaling import JointLoad
from tasks.bench.fabrication.servos import SERVOS

SERVO = SERVOS["ds3225"]
STALL, FASTEST = SERVO.stall_torque_nm, SERVO.no_load_speed_rad_s


def load(**changes: float) -> JointLoad:
    usual = {"peak_torque": 0.1, "rms_torque": 0.1, "peak_speed": 1.0, "use": 0.5, "stall_share": 0.1, "saturated": 0.0}
    return JointLoad(joint=2, **(usual | changes))


@pytest.mark.parametrize(
    ("load", "severity", "said"),
    [
        (load(), None, ""),
        (load(saturated=0.21), "warning", "at its torque limit in 21% of the run"),
        (load(saturated=0.19), None, ""),
        (load(stall_share=0.4), "warning", "overheats"),
        (load(peak_speed=1.1 * FASTEST, use=1.1), "fault", "kept_frequencies"),
        (load(peak_torque=1.2 * STALL, use=1.3), "fault", "servos_per_joint=2"),
        (load(use=1.0), "warning", "gives 1.00 times what the run needs"),
        (load(use=0.8), "warning", "gives 1.25 times what the run needs"),
        (load(use=0.75), None, ""),
    ],
)
def test_loads(load, severity, said):
    findings = list(check_loads([load], SERVO))
    assert [finding.severity for finding in findings] == ([severity] if severity else [])
    assert all(finding.where == "joint 2" and said in finding.message for finding in findings)


@pytest.mark.parametrize(
    ("draught", "sealed", "flooded", "said"),
    [
        (289.0, 0.5, 0.7, "stands on the floor of a 150 mm deep tank: its draught is 289 mm"),
        (149.0, 0.5, 0.7, None),
        (149.0, 0.5, 1.1, "sinks once they are full"),
        (None, 1.2, 1.5, "sinks: it weighs 1.20 times"),
    ],
)
def test_floating(draught, sealed, flooded, said):
    messages = list(check_floating(Floating(1.0, 2e-3, sealed, flooded, draught, 400.0), 150.0))
    assert len(messages) == (said is not None) and all(said in message for message in messages)


def test_an_engine_without_torques_is_no_fault_of_the_robot(crane, kit, settings):
    pytest.importorskip("mujoco", reason="mujoco is not installed")
    changes = {"target": "mujoco_fluid", "rollout": settings.rollout.model_copy(update={"n_settle": 5, "n_measure": 5})}
    source = DesignSource(crane, "crane", "", settings.model_copy(update=changes), 1.0, None)
    bench = bench_of(source, kit, FabricationSettings(), as_built(settings.physics))
    (finding,) = (finding for finding in bench.findings if finding.where == "joints")
    assert (finding.severity, bench.simulated) == ("warning", None) and "reports no torques" in finding.message


def test_the_run_and_the_floating_of_a_kit(crane, kit, settings):
    one_period = settings.rollout.model_copy(update={"n_settle": 60, "n_measure": 300})
    source = DesignSource(crane, "crane", "", settings.model_copy(update={"rollout": one_period}), 1.0, None)
    physics = as_built(settings.physics)
    run = bench_of(source, kit, FabricationSettings(), physics).simulated
    turned = np.cumsum(run.speed, axis=0) * physics.time_step  # of children on their parents
    assert np.ptp(turned, axis=0) == pytest.approx(2 * crane.motion_range[0, [2, 4]], rel=0.05)
    floats = floating_of(kit, fluid_density=1000.0)
    bottom = min(outline.bounds[1] for outline in kit.outlines)
    under = shapely.box(-1e3, bottom, 1e3, bottom + floats.draught_mm)
    area = sum(outline.intersection(under).area for outline in kit.outlines)
    assert 2 * 25.0 * area == pytest.approx(1000 * kit.mass_g, rel=1e-6)  # of two pontoons in water, Archimedes
