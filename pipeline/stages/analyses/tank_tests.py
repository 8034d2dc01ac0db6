"""The robot to build: champions in True Slush and on Dry Land, the one nearest the mean, and the virtual tank.

Part of the stage analyse, whose page lists the tables. Paper, "Physical Validation".
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pipeline.report.findings import TankRow
from pipeline.stages import segments
from pipeline.stages.analyses.champions import Champion, champions, roll_out
from pipeline.stages.analyses.statistics import Reasons, Tables
from pipeline.store.tables import columns_of
from pipeline.workflow.stage import Files, Job
from tasks.analysis import Crossing, Tank, crossings, nearest_the_mean
from tasks.design.genes import concatenate
from tasks.world import DryLand, Environment, Physics

AT_ONCE = 16
"""Champions whose traces are held together: 35,000 steps of one are 5 MB."""


def compute(job: Job, inputs: Mapping[str, Files]) -> tuple[Tables, Reasons]:
    """Put the champions of one arm on dry land and into the tank, and propose one of them."""
    spec = job.spec
    entrants = champions(spec["trials"], inputs)
    if not entrants:
        return {"tank": columns_of(TankRow, [])}, {"tank": "no trial has a champion"}
    chosen = nearest_the_mean(np.array([of.zero_shot for of in entrants]))
    dry_land = roll_out(job, DryLand(depth=spec["depth"]), concatenate([of.design for of in entrants]))
    tank = Tank.model_validate(spec["tank"])
    wet = _in_tank(job, tank, segments.true_slush(spec, tank.simulated_depth), entrants)
    dry = _in_tank(job, tank, DryLand(depth=0.0), entrants)
    root, whole = dry_land.displacement.tolist(), dry_land.com_displacement.tolist()
    rows = [
        TankRow(of.trial, i == chosen, of.zero_shot, root[i], whole[i], wet[i], dry[i]) for i, of in enumerate(entrants)
    ]
    reasons = {} if chosen is not None else {"tank": "no champion survived True Slush: there is no mean to be near"}
    return {"tank": columns_of(TankRow, rows)}, reasons


def _in_tank(job: Job, tank: Tank, world: Environment, entrants: list[Champion]) -> list[Crossing]:
    """Let every champion loose in the tank, alone."""
    time_step = Physics.model_validate(job.spec["physics"]).time_step
    n_settle = job.spec["rollout"]["n_settle"]
    spec = {**job.spec, "rollout": {"n_settle": n_settle, "n_measure": job.spec["n_steps"]}}
    found = []
    for first in range(0, len(entrants), AT_ONCE):
        designs = concatenate([of.design for of in entrants[first : first + AT_ONCE]])
        rollouts = segments.roll_out(spec, job.execution, world, designs, trace=True)
        found += crossings(designs, rollouts, tank, n_settle=n_settle, time_step=time_step)
    return found
