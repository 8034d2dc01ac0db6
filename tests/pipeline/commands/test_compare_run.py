"""puddle compare-run: the simulation itself as a robot that was built, and robots that differ from it."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
import yaml
from command_line import call as called

from pipeline.bench.fabrication.kit_files import KIT, write_folder
from pipeline.bench.vision.markers_file import RobotTags
from pipeline.commands.compare_run import read_kit
from pipeline.config.settings import RolloutSettings
from pipeline.report.run_page import verdict
from pipeline.results.recorded_study import open_study
from pipeline.store.design_file import design_json
from tasks.analysis.built_run import RunComparison, SteadyRun, steady_speed
from tasks.bench.fabrication.kit_settings import FabricationSettings, ThrowingKit
from tasks.bench.fabrication.timeline import RAMP
from tasks.simulation import simulate
from tasks.world import Physics, ResidualSlush, Slush, TrueSlush, froude_time

LOCKED = Physics(passive_joints="locked", link_collisions=True)
TIME = froude_time(0.07)
STEP = LOCKED.time_step * TIME
N_STEPS = 1900
BEGAN = 1.7  # when the servos begin in the video [s]


def call(*words):
    return called(*map(str, words))


@pytest.fixture(scope="module")
def robot(crane):
    return replace(crane, motion_range=np.where(crane.parent < 0, 0.2, crane.motion_range))


@pytest.fixture(scope="module")
def run(robot, tmp_path_factory):
    """A folder with the kit, the tracks of its simulation at bench scale, and its speed [m/s]."""
    folder = tmp_path_factory.mktemp("run")
    choices = FabricationSettings()
    files = {"design.json": design_json(robot)}
    simulated = {
        "depth": 2.0,
        "physics": LOCKED.model_dump(mode="json"),
        "environment": "true_slush",
        "media": {"true_slush": Slush().model_dump(mode="json")},
        "rollout": RolloutSettings().model_dump(mode="json"),
        "predicted": None,
    }
    manifest = {"name": "crane", "settings": choices.model_dump(mode="json"), "simulated": simulated}
    write_folder(KIT, folder / "kit", files, manifest)
    trace = simulate(robot, TrueSlush(depth=2.0), n_settle=0, n_measure=N_STEPS, trace=True, physics=LOCKED).trace[0]
    speed = tracks_of(folder / "run.csv", trace)
    return folder, trace, speed


def tracks_of(path, trace, *, links=range(6)):
    """Write what a camera would see of a simulated run, 60 times a second."""
    frame = np.arange(0.0, STEP * N_STEPS, 1 / 60)
    steps, rows = STEP * (1 + np.arange(N_STEPS)), []
    for link in links:
        x, y, angle = (np.interp(frame, steps, trace[:, link, i]) for i in range(3))
        rows += [(link, *row) for row in zip(frame + BEGAN, 0.07 * x, 0.07 * y, angle, strict=True)]
    path.write_text("throw,time,x,y,angle\n" + "\n".join(",".join(map(str, row)) for row in rows))
    steady = (frame > 2) & (frame < 8)
    period = TIME / 0.2
    x = 0.07 * np.interp(frame, steps, trace[:, 0, 0])[steady]
    n = round(60 * period)
    return (x[-n:].mean() - x[:n].mean()) / (len(x) - n) * 60


def compared(run, tmp_path, capsys, *options, tracks=None, kit=None):
    folder, _, _ = run
    page = tmp_path / "run.html"
    code = call("compare-run", tracks or folder / "run.csv", "--kit", kit or folder / "kit", "--out", page, *options)
    said = capsys.readouterr()
    return code, (said.out if code == 0 else said.err), page


def predicting(run, tmp_path, mean, spread):
    """Return a kit whose ensemble predicted a speed [m/s] and a deviation."""
    kit = tmp_path / "predicting"
    shutil.copytree(run[0] / "kit", kit)
    document = json.loads((kit / "kit.json").read_text())
    metres = TIME * 20.0 / 0.07
    document["simulated"]["predicted"] = [metres * (mean - spread), metres * (mean + spread)]
    (kit / "kit.json").write_text(json.dumps(document))
    return kit


def test_the_simulation_as_a_robot_is_as_simulated(run, tmp_path, capsys):
    code, said, page = compared(run, tmp_path, capsys)
    assert code == 0 and "No ensemble predicts this run" in said
    (_, measured, gait), (_, simulated, expected) = (numbers(said, what) for what in ("measured", "simulated"))
    assert measured == pytest.approx(1000 * run[2], abs=0.5) and gait == expected == pytest.approx(0.2 / TIME, abs=0.01)
    assert abs(measured - simulated) < 0.1 * abs(measured) + 1  # other windows of a run that is not quite periodic
    assert page.read_text().count("<svg") == 1


def numbers(said, what):
    """Displacement [mm], speed [mm/s] and gait [Hz] in a line of the table."""
    line = next(line for line in said.splitlines() if line.startswith(what))
    return [float(word.replace("−", "-")) for word in re.findall(r"[+−-]?\d+(?:\.\d+)?", line)]


@pytest.mark.parametrize(
    ("speed", "spread", "said"),
    [
        (0.02, 0.003, "moved as predicted: "),
        (0.04, 0.003, "did not move as predicted: "),
        (0.02, 0.1, "moved as predicted, but the prediction leaves the direction open: "),
    ],
)
def test_a_sentence_says_whether_the_prediction_held(run, speed, spread, said):
    robot = replace(read_kit(run[0] / "kit"), predicted=np.array([0.02 - spread, 0.02 + spread]))
    measured = SteadyRun(np.arange(2.0), np.arange(2.0), speed, 0.75)
    sentence = verdict(RunComparison(robot, measured, measured))
    assert said in sentence
    assert interval(sentence) == pytest.approx([20 - 2000 * spread, 20 + 2000 * spread])


def interval(said):
    """The ends of the predicted interval [mm/s]."""
    return list(map(float, re.search(r"says (\S+) to (\S+)\.$", said.replace("−", "-").strip()).groups()))


def test_the_ensemble_of_a_study_predicts_the_run(run, recorded, tmp_path, capsys):
    """For a rollout, as what a kit records of its own: with the physics and in the depth of the kit."""
    code, said, _ = compared(run, tmp_path, capsys, "--study", "tiny", "--store", recorded)
    assert code == 0 and "the ensemble of study tiny says" in said.splitlines()[-1]
    study = open_study("tiny", recorded)
    kit, rollout = read_kit(run[0] / "kit"), study.settings.rollout
    steps = {"n_settle": rollout.n_settle, "n_measure": rollout.n_measure, "physics": kit.physics}
    found = simulate(kit.design, ResidualSlush(depth=2.0, ensemble=study.ensemble()), **steps).displacement
    seconds = rollout.n_measure * study.settings.physics.time_step * TIME
    expected = [1000 * 0.07 * (found.mean() + k * found.std()) / seconds for k in (-2, 2)]
    assert interval(said) == pytest.approx(expected, abs=0.051)


def test_the_kit_of_a_study_has_the_prediction_of_its_own_trial(run, recorded, tmp_path, capsys):
    kit = predicting(run, tmp_path, 0.02, 0.003)
    document = json.loads((kit / "kit.json").read_text())
    (kit / "kit.json").write_text(json.dumps(document | {"name": "tiny-trial-1"}))
    alone, with_study = (
        compared(run, tmp_path, capsys, *options, kit=kit)[:2]
        for options in ((), ("--study", "tiny", "--store", recorded))
    )
    assert alone == with_study and interval(alone[1]) == pytest.approx([14.0, 26.0], abs=0.1)


@pytest.mark.parametrize("option", [("--slowdown", 8), ("--lens", "board.mp4"), ("--markers", "markers.yaml")])
def test_options_of_a_video_are_refused_for_tracks(run, option, tmp_path, capsys):
    code, said, _ = compared(run, tmp_path, capsys, *option)
    assert code == 2 and "are for a video, not for tracks" in said


HEAD = "throw,time,x,y,angle\n"


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (lambda run, path: tracks_of(path, run[1], links=(2, 4)), "expected tags of link 0"),
        (lambda run, path: tracks_of(path, run[1], links=(0, 1)), "joints do not swing"),
        (lambda run, path: path.write_text(HEAD + "7,0,0,0,0\n"), "expected links of a robot, 0 to 5"),
        (lambda run, path: path.write_text("throw,time,x\n0,0,0\n"), "without y, angle"),
        (lambda run, path: path.write_text(HEAD + "0,1,0,0,0\n2,1,0,0.1,0\n"), "expected at least two periods"),
    ],
)
def test_tracks_of_something_else(write, message, run, tmp_path, capsys):
    write(run, tmp_path / "tracks.csv")
    code, said, page = compared(run, tmp_path, capsys, tracks=tmp_path / "tracks.csv")
    assert code == 2 and message in said and not page.exists()


def test_a_kit_of_another_gait_and_what_is_no_kit(run, robot, tmp_path, capsys):
    kit = predicting(run, tmp_path, 0.0, 1.0)
    faster = replace(robot, frequency=robot.frequency / 1.5)
    (kit / "design.json").write_bytes(design_json(faster))
    assert "is this the kit of another" in compared(run, tmp_path, capsys, kit=kit)[1]
    assert "expected a kit of `puddle fabricate`" in compared(run, tmp_path, capsys, kit=tmp_path)[1]
    video = tmp_path / "run.mp4"
    assert "a video needs --markers" in compared(run, tmp_path, capsys, tracks=video)[1]


def test_a_filmed_robot_that_is_slower_than_its_simulation_is_found_to_be(run, tmp_path, capsys):
    """It goes half as far. Speeds are between means over the first and the last period of the steady gait.

    A pixel is 1 mm, and a corner is found to half of one. If all corners of a period were off by that, in opposite
    directions at the start and at the end, the way between would be wrong by 1 mm.
    """
    pytest.importorskip("cv2", reason="opencv-python-headless is not installed")
    from synthetic_run import film_run
    from synthetic_tank import TankCamera, TankScene, markers_of_tank

    folder, _, speed = run
    markers = markers_of_tank(ThrowingKit(tank_length=0.64, tank_height=0.46, waterline=0.12))
    markers = markers.model_copy(update={"robot": RobotTags(tag_size=0.025)})  # 4 px for each of its squares
    (tmp_path / "markers.yaml").write_text(yaml.safe_dump(markers.model_dump(mode="json")))
    camera = TankCamera(width=800, height=592, field=0.82, distance=1.1, rate=12, exposure=0.004)
    video, seconds, period = tmp_path / "run.mp4", 6.2, TIME / 0.2
    truth = film_run(video, TankScene(camera, markers), read_kit(folder / "kit"), seconds, slower=0.5)
    steady = (truth["throw"] == 0) & (truth["time"] >= 1.0 + RAMP)  # the servos begin after a second

    kit = predicting(run, tmp_path, speed, 0.1 * speed)
    code, said, _ = compared(run, tmp_path, capsys, "--markers", tmp_path / "markers.yaml", tracks=video, kit=kit)
    assert code == 0 and "5 links, lost in 0 of" in said  # the tag of link 1 is behind that of the root
    lasted = float(re.search(r"crane: ([\d.]+) s of steady gait", said)[1])
    assert lasted == pytest.approx(np.ptp(truth["time"][steady]), abs=0.5)
    measured, simulated = (numbers(said, what)[1] / 1000 for what in ("measured", "simulated"))
    slow = steady_speed(truth["time"][steady], truth["x"][steady], period)
    assert measured == pytest.approx(slow, abs=0.001 / (lasted - period)) and slow == pytest.approx(speed / 2, rel=0.1)
    assert simulated == pytest.approx(speed, rel=0.05)
    assert said.splitlines()[-1].startswith("The robot did not move as predicted")
