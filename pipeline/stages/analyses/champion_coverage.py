"""How much of what champions do where they evolved lies outside the throws that their networks learned from.

Part of the stage analyse, whose page lists the table. No true slush is involved, so it shows where to distrust a
prediction when the truth is not known.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.config.settings import RESIDUAL_ENVIRONMENTS
from pipeline.report.findings import ChampionCoverageRow
from pipeline.stages import environments
from pipeline.stages.analyses.champions import Champion
from pipeline.stages.analyses.filmed_rollouts import home_of
from pipeline.stages.analyses.specs import InstrumentsSpec
from pipeline.stages.collect import read_transitions, throws_among
from pipeline.stages.environments import home_networks_among, networks_among
from pipeline.workflow.identity import InputName, TrialId
from pipeline.workflow.stage import Inputs, Job
from tasks.analysis.coverage import coverage, observed_states
from tasks.arrays import Float32
from tasks.design.genes import concatenate
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
    states = {trial: found for trial, found in _states(job, inputs, arm).items() if len(found)}
    if not states:
        return ()
    scale = deviations(np.concatenate(list(states.values())))
    data_sets = {trial: environments.data_set_among(inputs, trial) for trial in states}
    thrown = {
        data_set: read_transitions(throws_among(inputs, data_set)).observation for data_set in set(data_sets.values())
    }
    return [
        ChampionCoverageRow(trial.index, row)
        for trial, found in states.items()
        for row in coverage(found, thrown[data_sets[trial]], scale)
    ]


def _states(job: Job[InstrumentsSpec], inputs: Inputs, arm: Sequence[Champion]) -> dict[TrialId, Float32]:
    """Return states of champions' links where they evolved, under every member; one simulation for each home."""
    spec, networks = job.spec, networks_among(inputs)
    n_settle = spec.simulation.rollout.n_settle
    by_home: dict[tuple[InputName, ...], list[Champion]] = {}
    for champion in arm:
        by_home.setdefault(tuple(home_networks_among(networks, champion.trial)), []).append(champion)
    states: dict[TrialId, Float32] = {}
    for champions in by_home.values():
        home = home_of(spec.simulation, champions[0], networks)
        designs = concatenate([champion.design for champion in champions])
        rollouts = environments.roll_out(spec.simulation, job.execution, home, designs, trace=True)
        assert rollouts.trace is not None
        for number, champion in enumerate(champions):
            trial = champion.trial
            rng = generator(spec.seed, "analyse", "coverage", trial.environment, trial.depth, trial.index)
            own = replace(rollouts, trace=np.take(rollouts.trace, [number], axis=-4))
            states[trial] = observed_states(champion.design, own, n_settle=n_settle, rng=rng, n_most=_N_STATES)
    return {champion.trial: states[champion.trial] for champion in arm}
