"""The physical variant from throws to the proposed robot, with a preset small enough for seconds."""

import json
import re

import numpy as np
import pytest
from command_line import call
from small_study import files_of, labelled, run

from pipeline.cluster import serial_cluster
from pipeline.config.loading import load, preset_path
from pipeline.config.settings import Settings
from pipeline.stages.analyse import ANALYSE, table_file
from pipeline.stages.evolve import EVOLVE
from pipeline.stages.files import HISTORY
from pipeline.stages.report import PAGE, REPORT
from pipeline.store.design_file import design_from
from pipeline.store.store import Store
from pipeline.workflow.identity import Arm, OutputId
from pipeline.workflow.stage import StoredFiles
from tasks.analysis.tables import ANALYSES
from tasks.bench.fabrication.kit_settings import KitSettings
from tasks.bench.fabrication.servos import SERVOS
from tasks.design import Designs
from tasks.evolution import OPERATORS
from tasks.world.physics import froude_time

SMALL = (
    "learners.designed_throws.throws.n_throws=6",
    "learners.designed_throws.throws.n_steps=20",
    "network.hidden_layers=1",
    "network.width=4",
    "training.n_iterations=20",
    "training.batch_size=64",
    "ensemble.n_members=2",
    "grid.n_trials=3",
    "rollout.n_settle=30",
    "rollout.n_measure=60",
    "evolution.n_generations=3",
    "evolution.afpo.population_size=6",
    "work.generations_per_item=2",
    "transfer.adapted_environments=[designed_throws]",
    "transfer.n_generations=2",
    "tank.seconds=0.5",
    "work.engine=reference",
)
"""Overrides as a user would write them. The adaptation shows that motors are kept; the reference engine compiles
nothing."""
ARM = "designed_throws/2m"


@pytest.fixture(scope="module")
def pontoon() -> Settings:
    return load(Settings, preset_path("pontoon"), SMALL)


@pytest.fixture(scope="module")
def built(pontoon, tmp_path_factory):
    store = Store.open(tmp_path_factory.mktemp("pontoon") / "store", create=True)
    with serial_cluster() as cluster:
        upstream = run(pontoon, store, cluster)
    assert not any(results.failed for results in upstream.values())
    return store, upstream


@pytest.fixture(scope="module")
def tank(built):
    store, upstream = built
    (done,) = upstream["analyse"].done[OutputId("tank", Arm("designed_throws", 2.0))]
    return table_file(ANALYSES["tank"]).read([files_of(store, done)])


def test_the_preset_is_what_the_paper_built_within_what_servos_give():
    settings = load(Settings, preset_path("pontoon"))
    assert settings.trials() == [("designed_throws", 2.0, trial) for trial in range(16)]
    assert (settings.rollout.n_settle, settings.rollout.n_measure) == (1000, 5000)
    physics, morphology = settings.physics, settings.evolution.morphology
    assert (physics.max_motor_torque, physics.passive_joints, physics.link_collisions) == (30, "locked", True)
    assert (morphology.n_actuated, morphology.unjoined_links) == (2, "apart_in_gait")
    tank = settings.tank
    assert (tank.length, tank.depth, tank.scale, tank.seconds) == (1.17, 0.15, 0.07, 150)
    assert (tank.width, tank.height, tank.pontoon_pitch, tank.pontoon_thickness) == (0.33, 0.27, 0.3, 0.025)
    kit = KitSettings()
    servo, frequency = SERVOS[kit.servo], 1 / froude_time(tank.scale)  # of the bench, per frequency of the simulation
    torque = physics.max_motor_torque / tank.simulated_servo_torque(physics.link_density)
    assert morphology.max_joint_speed == physics.max_motor_speed
    assert 0.5 < torque + physics.max_motor_speed * frequency / servo.no_load_speed_rad_s < 1 / 1.3
    assert (kit.pitch_mm, kit.thickness_mm) == (1000 * tank.pontoon_pitch, 1000 * tank.pontoon_thickness)


def test_everything_that_evolves_can_be_built(pontoon, built):
    store, upstream = built
    for stage in ("evolve", "adapt"):
        for label, segments in labelled(upstream[stage].done).items():
            for segment in segments:
                designs = Designs.from_arrays(HISTORY.read([StoredFiles(store, segment)], label))
                assert pontoon.evolution.morphology.allows(designs).all()
                assert (designs.motor_on.sum(axis=1) == 2).all()


def test_the_share_of_rejected_draws_is_reported(pontoon, built):
    store, upstream = built
    summary = EVOLVE.summarise(pontoon, upstream, store)
    segments = [StoredFiles(store, segment) for items in upstream["evolve"].done.values() for segment in items]
    history = HISTORY.read(segments)
    draws, codes = history["n_draws"], history["operator"]
    assert summary.metrics["rejected_share.random"] > 0.99
    for code, operator in enumerate(OPERATORS):
        mine = draws[codes == code]
        share = (mine - 1).sum() / mine.sum()
        assert summary.metrics.get(f"rejected_share.{operator}", 0.0) == pytest.approx(share)
        assert not share or f"{share:.1%} of {mine.sum():,} by {operator}" in "\n".join(summary.lines)


def test_the_champion_nearest_the_mean_is_proposed(built, tank):
    store, upstream = built
    scores = [
        json.loads(store.read(chain[-1], "score.json"))["zero_shot"] for chain in upstream["transfer"].done.values()
    ]
    np.testing.assert_array_equal(tank["zero_shot"], scores)
    distance = np.abs(np.array(scores) - np.mean(scores))
    assert tank["proposed"].sum() == 1
    assert distance[tank["proposed"]][0] == distance.min()
    for where in ("wet", "dry", "dry_servo"):  # no robot travels 10 m in 0.5 s / √0.07
        assert (tank[f"{where}_trials_n"] == 8).all() and not tank[f"{where}_trials_n_crossed"].any()
    assert np.isfinite(tank["length_cm"]).all()


def test_summary_page_and_design_file_name_the_robot_to_build(pontoon, built, tank, tmp_path, capsys):
    store, upstream = built
    (trial,) = tank["trial"][tank["proposed"]].tolist()
    summary = ANALYSE.summarise(pontoon, upstream, store)
    assert "Which robot is worth building, and would it cross the tank?" in summary.lines
    summary = REPORT.summarise(pontoon, upstream, store)
    (path,) = (line.removesuffix(": a robot to build") for line in summary.lines if line.endswith("a robot to build"))
    page = summary.artifacts[PAGE].decode()
    text = " ".join(re.sub(r"<[^>]+>", " ", page).split())
    assert "The robot to build" in text and "crosses 0 of 8, immobile" in text
    assert re.search(r"rejected and drawn again: 100 % from random, \d+ % from mutation", text)
    assert "as far to the right as they can in 1 seconds" in text
    # The exported file is a design file like any other, and describes the champion itself.
    (champion,) = (store.read(labelled(upstream["transfer"].done)[f"{ARM}/trial-{trial}"][-1], "champion.json"),)
    written = store.root / "studies" / "pontoon" / "report" / "proposed-designed_throws-2m.json"
    assert str(written) == path
    assert written.read_bytes() == champion
    design_from(champion, "proposed")
    film = tmp_path / "film.gif"
    (tmp_path / "pontoon.yaml").write_text(pontoon.model_dump_json())
    options = ("--settings", str(tmp_path / "pontoon.yaml"), "--store", str(store.root), "--depth", "2")
    assert call("simulate", str(written), "--environment", "true_slush", "--out", str(film), *options) == 0
    moved = float(re.search(r"root ([+-][\d.]+) m", capsys.readouterr().out)[1])
    assert moved == pytest.approx(tank["zero_shot"][tank["proposed"]][0], abs=5e-4)
    assert film.read_bytes().startswith(b"GIF89a")


def test_a_study_without_a_tank_proposes_no_design(settings, study):
    store, upstream = study
    assert not [label for label in labelled(upstream["analyse"].done) if label.startswith("tank/")]
    summary = REPORT.summarise(settings, upstream, store)
    assert len(summary.lines) == 1
    assert 'id="tank"' not in summary.artifacts[PAGE].decode()
