"""The robot to build: champions in the virtual tank, filled and drained. Paper, "Physical Validation"."""

from dataclasses import dataclass

import numpy as np

from tasks.analysis.columns import SCORE, OfTrial, column
from tasks.analysis.registry import analysis
from tasks.analysis.study import StudyData
from tasks.analysis.tank import TankTrials, count_crossings, crossings, nearest_the_mean, restarted
from tasks.world import DryLand, Environment, Physics


def written_trials(trials: TankTrials) -> str:
    """Write how often a robot crossed, and how often it stayed."""
    return f"crosses {trials.n_crossed} of {trials.n}, immobile {trials.n_immobile}"


@dataclass(frozen=True)
class TankRow(OfTrial):
    """A champion in the virtual tank."""

    proposed: bool = column("to build", form=lambda chosen: "✓" if chosen else "", meaning="Nearest to the mean.")
    zero_shot: float = column("zero-shot", SCORE, meaning="Displacement of the root in the target, at its own depth.")
    length_cm: float = column("length", "cm", form="{:.0f}", meaning="As built, settled in the filled tank.")
    wet_trials: TankTrials = column("in the tank", form=written_trials)
    dry_trials: TankTrials = column("on the dry floor", form=written_trials)
    dry_servo_trials: TankTrials = column("with the servo's torque", form=written_trials)


@analysis(
    "tank",
    row=TankRow,
    reads=("champions",),
    answers="Which robot is worth building, and would it cross the tank?",
    section="tank",
    each="arm",
    needs_tank=True,
    version=3,
    cost=200,
)
def tank(study: StudyData) -> list[TankRow]:
    """Simulate the champions of one arm in the tank, and propose one of them for building."""
    champions, tank, physics = study.champions, study.settings.tank, study.settings.physics
    if tank is None or not champions:
        return []
    chosen = nearest_the_mean(np.array([champion.zero_shot for champion in champions]))
    with_servo = physics.model_copy(update={"max_motor_torque": tank.simulated_servo_torque(physics.link_density)})
    filled, drained = study.at_target(tank.simulated_depth), DryLand(depth=0.0)
    tests: tuple[tuple[Environment, Physics], ...] = ((filled, physics), (drained, physics), (drained, with_servo))
    rows = []
    for i, champion in enumerate(champions):
        rng = study.rng("tank", *champion.key)
        tries = restarted(champion.design, tank.n_trials, rng)
        outcomes = []
        for at, under in tests:
            rollouts = study.simulate(at, tries, trace=True, physics=under, n_measure=tank.n_steps(under.time_step))
            outcomes.append(crossings(tries, rollouts, tank, n_settle=study.settings.n_settle))
        rows.append(
            TankRow(
                *champion.key,
                i == chosen,
                champion.zero_shot,
                100 * float(tank.scale * outcomes[0].length[0]),
                *(count_crossings(trials, tank) for trials in outcomes),
            )
        )
    return rows
