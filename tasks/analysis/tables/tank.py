"""The robot to build: champions in the virtual tank, filled and drained. Paper, "Physical Validation"."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tasks.analysis.registry import OfTrial, StudyData, analysis, column
from tasks.analysis.tank import Crossings, Tank, TankTrials, count_crossings, crossings, nearest_the_mean, restarted
from tasks.design import Designs
from tasks.world import DryLand, Environment, Physics

_TRIALS_AT_ONCE = 16  # trials whose traces are in memory at the same time: 35,000 steps of one are 5 MB


def written_trials(trials: TankTrials) -> str:
    """Write how often a robot crossed, and how often it stayed."""
    return f"crosses {trials.n_crossed} of {trials.n}, immobile {trials.n_immobile}"


@dataclass(frozen=True)
class TankRow(OfTrial):
    """A champion in the virtual tank."""

    proposed: bool = column("to build", form=lambda chosen: "✓" if chosen else "", meaning="Nearest to the mean.")
    zero_shot: float | None = column("zero-shot", "m", meaning="Displacement in the target, at its own depth.")
    length_cm: float | None = column("length", "cm", form="{:.0f}", meaning="As built, settled in the filled tank.")
    wet_trials: TankTrials = column("in the tank", form=written_trials)
    dry_trials: TankTrials = column("on the dry floor", form=written_trials)
    dry_servo_trials: TankTrials = column("with the servo's torque", form=written_trials)


def _metrics(rows: Sequence[TankRow]) -> dict[str, float | None]:
    found: dict[str, float | None] = {}
    for row in rows:
        if row.proposed:
            prefix = f"tank.{row.environment}.{row.depth:g}m.proposed"
            found[f"{prefix}.zero_shot"] = row.zero_shot
            found[f"{prefix}.wet_share_crossed"] = row.wet_trials.n_crossed / row.wet_trials.n
            found[f"{prefix}.dry_servo_share_immobile"] = row.dry_servo_trials.n_immobile / row.dry_servo_trials.n
    return found


@analysis(
    "tank",
    row=TankRow,
    reads=("transfer",),
    answers="Which robot is worth building, and would it cross the tank?",
    section="tank",
    each="arm",
    needs_tank=True,
    version=3,
    metrics=_metrics,
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
        rng = study.rng("tank", champion.environment, champion.depth, champion.trial)
        tries = restarted(champion.design, tank.n_trials, rng)
        found = [_in_tank(study, tank, at, under, tries) for at, under in tests]
        rows.append(
            TankRow(
                champion.environment,
                champion.depth,
                champion.trial,
                i == chosen,
                _known(champion.zero_shot),
                _known(100 * tank.scale * found[0].length[0]),
                *(count_crossings(trials, tank) for trials in found),
            )
        )
    return rows


def _in_tank(study: StudyData, tank: Tank, at: Environment, under: Physics, tries: Designs) -> Crossings:
    """Simulate the trials of a robot in the tank."""
    n_steps, parts = tank.n_steps(under.time_step), list[Crossings]()
    for first in range(0, len(tries), _TRIALS_AT_ONCE):
        designs = tries[first : first + _TRIALS_AT_ONCE]
        rollouts = study.simulate(at, designs, trace=True, physics=under, n_measure=n_steps)
        parts.append(crossings(designs, rollouts, tank, n_settle=study.settings.n_settle))
    return Crossings(*map(np.concatenate, zip(*parts, strict=True)))


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
