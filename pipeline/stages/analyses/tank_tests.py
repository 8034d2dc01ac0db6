"""The robot to build: champions in True Slush and on Dry Land, the one nearest the mean, and the virtual tank.

Part of the stage analyse, whose page lists the tables. Paper, "Physical Validation".
"""

from dataclasses import replace

import numpy as np
from numpy.random import Generator

from pipeline.report.findings import TankRow
from pipeline.stages import environments
from pipeline.stages.analyses.analysis_tables import Reasons, Tables
from pipeline.stages.analyses.champions import Champion, champions
from pipeline.stages.analyses.specs import TankSpec
from pipeline.store.tables import columns_of
from pipeline.workflow.stage import Execution, Inputs, Job
from tasks.analysis.tank import Crossing, count_crossings, crossings, nearest_the_mean, restarted
from tasks.design import Designs
from tasks.design.genes import concatenate
from tasks.seeding import generator
from tasks.world import DryLand, Environment, Physics

_TRIALS_AT_ONCE = 16  # trials whose traces are in memory at the same time: 35,000 steps of one are 5 MB


def compute(job: Job[TankSpec], inputs: Inputs) -> tuple[Tables, Reasons]:
    """Simulate the champions of one arm on Dry Land and in the tank, and propose one of them for building."""
    spec = job.spec
    entrants = champions(spec.trials, inputs)
    if not entrants:
        return {"tank": columns_of(TankRow, [])}, {"tank": "no trial has a champion"}
    chosen = nearest_the_mean(np.array([champion.zero_shot for champion in entrants]))
    designs = concatenate([champion.design for champion in entrants])
    dry_land = environments.roll_out(spec.simulation, job.execution, DryLand(depth=spec.arm.depth), designs)
    filled = environments.true_slush(spec.simulation.media, spec.tank.simulated_depth)
    drained, physics = DryLand(depth=0.0), spec.simulation.physics
    servo_torque = spec.tank.simulated_servo_torque(physics.link_density)
    with_servo = physics.model_copy(update={"max_motor_torque": servo_torque})
    tests: tuple[tuple[Environment, Physics], ...] = ((filled, physics), (drained, physics), (drained, with_servo))
    root, whole = dry_land.displacement.tolist(), dry_land.com_displacement.tolist()
    rows = []
    for i, champion in enumerate(entrants):
        tries = restarted(champion.design, spec.tank.n_trials, _generator(spec, champion))
        wet, dry, dry_servo = (_in_tank(spec, job.execution, at, under, tries) for at, under in tests)
        counts = (count_crossings(trials, spec.tank) for trials in (wet, dry, dry_servo))
        moved = champion.zero_shot, root[i], whole[i]
        limits = physics.max_motor_torque, with_servo.max_motor_torque
        rows.append(TankRow(champion.trial.index, i == chosen, *moved, wet[0], dry[0], dry_servo[0], *limits, *counts))
    reasons = {} if chosen is not None else {"tank": "no champion survived True Slush: there is no mean to be near"}
    return {"tank": columns_of(TankRow, rows)}, reasons


def _generator(spec: TankSpec, champion: Champion) -> Generator:
    return generator(
        spec.seed, "analyse", "tank", champion.trial.environment, champion.trial.depth, champion.trial.index
    )


def _in_tank(
    spec: TankSpec, execution: Execution, environment: Environment, physics: Physics, tries: Designs
) -> list[Crossing]:
    """Simulate the trials of a robot in the tank."""
    rollout = spec.simulation.rollout.model_copy(update={"n_measure": spec.n_steps})
    simulation = replace(spec.simulation, rollout=rollout, physics=physics)
    found = []
    for first in range(0, len(tries), _TRIALS_AT_ONCE):
        designs = tries[first : first + _TRIALS_AT_ONCE]
        rollouts = environments.roll_out(simulation, execution, environment, designs, trace=True)
        found += crossings(designs, rollouts, spec.tank, n_settle=rollout.n_settle, time_step=physics.time_step)
    return found
