"""How much of what champions do where they evolved lies outside the throws that their networks learned from.

Part of the stage analyse, whose page lists the table. No true slush is involved, so it shows where to distrust a
prediction when the truth is not known.
"""

from collections.abc import Sequence

import numpy as np

from pipeline.config.settings import RESIDUAL_ENVIRONMENTS
from pipeline.report.findings import ChampionCoverageRow
from pipeline.stages import environments
from pipeline.stages.analyses.champions import Champion
from pipeline.stages.analyses.filmed_rollouts import home_of
from pipeline.stages.analyses.specs import InstrumentsSpec
from pipeline.stages.collect import read_transitions, throws_among
from pipeline.stages.environments import networks_among
from pipeline.workflow.stage import Inputs, Job
from tasks.analysis.coverage import coverage, observed_states
from tasks.arrays import Float32
from tasks.residual.support import deviations
from tasks.seeding import generator

_N_STATES = 2_000  # of each champion: a share is then known to 2 %


def champion_coverage(
    job: Job[InstrumentsSpec], inputs: Inputs, arm: Sequence[Champion]
) -> Sequence[ChampionCoverageRow]:
    """Compare the champions of one arm with the throws: none if they evolved without networks.

    Args:
        job: the work item.
        inputs: files by name, with the networks and the throws.
        arm: champions of the arm.

    Returns:
        For each champion a row for all components, and one for each component.
    """
    if job.spec.arm.environment not in RESIDUAL_ENVIRONMENTS:
        return ()
    states = {of.trial: found for of in arm if len(found := _states(job, inputs, of))}
    if not states:
        return ()
    scale = deviations(np.concatenate(list(states.values())))
    data_sets = {of: environments.data_set_among(inputs, of) for of in states}
    thrown = {of: read_transitions(throws_among(inputs, of)).observation for of in set(data_sets.values())}
    return [
        ChampionCoverageRow(of.index, row)
        for of, found in states.items()
        for row in coverage(found, thrown[data_sets[of]], scale)
    ]


def _states(job: Job[InstrumentsSpec], inputs: Inputs, champion: Champion) -> Float32:
    """Return states of a champion's links where it evolved, under every member."""
    spec, trial = job.spec, champion.trial
    home = home_of(spec.simulation, champion, networks_among(inputs))
    rollouts = environments.roll_out(spec.simulation, job.execution, home, champion.design, trace=True)
    rng = generator(spec.seed, "analyse", "coverage", trial.environment, trial.depth, trial.index)
    n_settle = spec.simulation.rollout.n_settle
    return observed_states(champion.design, rollouts, n_settle=n_settle, rng=rng, n_most=_N_STATES)
