"""The champion of each arm that is proposed for building: its design file, and its films in the tank.

Part of the stage report.
"""

from typing import Any

from pipeline.config.settings import Settings
from pipeline.report.findings import TankRow
from pipeline.report.replay import Replay, replay_of
from pipeline.stages import environments
from pipeline.stages.analyses.analysis_tables import read_rows
from pipeline.stages.analyses.specs import TANK
from pipeline.stages.part import PartId
from pipeline.stages.transfer import CHAMPION, SCORED
from pipeline.store.design_file import design_from
from pipeline.store.encoding import decode_json
from pipeline.workflow.identity import InputName, TrialId, arms_of, trials_of
from pipeline.workflow.stage import Files, Inputs
from tasks.simulation import OK, simulate
from tasks.world import ENVIRONMENTS, DryLand

ANALYSED = "analysed"  # role of the inputs that are the tables of an analysis
PROPOSED = "proposed-"  # prefix of the design files of proposed champions
_MOST_SECONDS_IN_TANK = 60.0  # limit on the films of the tank: a minute of a robot that does not move is enough [s]


def proposed(settings: Settings, inputs: Inputs) -> list[TrialId]:
    """Return the champion of each arm that is proposed for building; none without a tank."""
    found: list[TrialId] = []
    for arm, trials in arms_of(trials_of(settings, "transfer")).items():
        rows = read_rows(inputs.get(InputName(ANALYSED, PartId(TANK, arm))), "tank", TankRow)
        chosen = {row.trial for row in rows if row.proposed}
        found += [trial for trial in trials if trial.index in chosen]
    return found


def proposal_files(trials: list[TrialId], inputs: Inputs) -> Files:
    """Return the design files of proposed champions, named after their arms; the store allows one dot in a name."""
    return {
        f"{PROPOSED}{trial.environment}-{trial.depth:g}m".replace(".", "_") + ".json": _champion_file(trial, inputs)
        for trial in trials
    }


def _champion_file(trial: TrialId, inputs: Inputs) -> bytes:
    return inputs[InputName(SCORED, trial)][CHAMPION]


def tank_replays(settings: Settings, trial: TrialId, inputs: Inputs, engine: Any) -> list[Replay]:
    """Return replays of a proposed champion in the tank and on its dry floor, without those that diverged.

    Args:
        settings: settings of the study.
        trial: trial of the champion.
        inputs: files by name, with its scores.
        engine: the engine.
    """
    assert settings.tank is not None
    design = design_from(decode_json(_champion_file(trial, inputs), trial.label), trial.label)
    style = ENVIRONMENTS[trial.environment]
    tank, n_settle, time_step = settings.tank, settings.rollout.n_settle, settings.physics.time_step
    replays = []
    for surrounding, words in (
        (environments.true_slush(environments.media_of(settings, "true_slush"), tank.simulated_depth), "the tank"),
        (DryLand(depth=0.0), "the drained tank"),
    ):
        rollouts = simulate(
            design,
            surrounding,
            n_settle=n_settle,
            n_measure=min(tank.n_steps(time_step), round(_MOST_SECONDS_IN_TANK / time_step)),
            engine=engine,
            trace=True,
            physics=settings.physics,
        )
        if rollouts.status[0] == OK:
            assert rollouts.trace is not None
            replays.append(
                replay_of(
                    design,
                    rollouts.trace[0],
                    title=f"To build: evolved {style.evolved}, trial {trial.index}, in {words}",
                    environment="",
                    seen_in=words,
                    depth=round(surrounding.depth, 2),
                    surroundings="air" if surrounding.medium is None else "true slush",
                    n_settle=n_settle,
                    time_step=time_step,
                )
            )
    return replays
