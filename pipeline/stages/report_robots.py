"""Robots that readers of the page can watch and take with them: every champion, and the designs that exploit most.

Part of the stage report.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from pipeline.report.data import MOST_EXPLOITERS, robot_address
from pipeline.report.findings import ExploiterRow
from pipeline.stages import environments
from pipeline.stages.analyses.analysis_tables import read_rows
from pipeline.stages.analyses.champions import Champion, champions
from pipeline.stages.analyses.filmed_rollouts import NO_MEMBER, Filmed, median_member
from pipeline.stages.analyses.specs import EXPLOITERS
from pipeline.stages.assess import assessed_among, read_predictions
from pipeline.stages.data_sets import NetworkId, own_network
from pipeline.stages.environments import SimulationSpec, networks_among
from pipeline.stages.part import PartId
from pipeline.stages.proposed_design import ANALYSED
from pipeline.store.design_file import design_document
from pipeline.store.encoding import encode_json
from pipeline.workflow.identity import InputName, TrialId
from pipeline.workflow.stage import Execution, Files, Inputs
from tasks.design import Designs
from tasks.design.genes import concatenate
from tasks.simulation import OK
from tasks.world import ENVIRONMENTS, ResidualSlush


def address_of(champion: Champion) -> str:
    """Return the address of a champion on the page."""
    trial = champion.trial
    return robot_address(trial.environment, trial.depth, trial.index)


def in_true_slush(simulation: SimulationSpec, execution: Execution, arm: Sequence[Champion]) -> list[Filmed]:
    """Return films of the champions of an arm in True Slush, the best first; those that diverge are left out.

    Args:
        simulation: physics, rollout, and the medium of True Slush.
        execution: the engine.
        arm: champions of one arm.
    """
    ranked = sorted(
        (champion for champion in arm if np.isfinite(champion.zero_shot)), key=lambda champion: -champion.zero_shot
    )
    if not ranked:
        return []
    environment = environments.true_slush(simulation.media, ranked[0].trial.depth)
    designs = concatenate([champion.design for champion in ranked])
    rollouts = environments.roll_out(simulation, execution, environment, designs, trace=True)
    assert rollouts.trace is not None
    return [
        Filmed(champion, "true_slush", NO_MEMBER, float(rollouts.displacement[i]), rollouts.trace[i : i + 1])
        for i, champion in enumerate(ranked)
        if rollouts.status[i] == OK
    ]


def exploiters(inputs: Inputs, trials: Sequence[TrialId]) -> Mapping[str, tuple[ExploiterRow, Champion]]:
    """Return the exploiters that the page lists, by address; an assessed design stands in for a champion.

    Args:
        inputs: scores, predictions, and the ranking of exploiters where there is one.
        trials: trials of the champions.
    """
    rows = read_rows(inputs.get(InputName(ANALYSED, PartId(EXPLOITERS))), "exploiters", ExploiterRow)[:MOST_EXPLOITERS]
    shares = assessed_among(inputs)
    assessed = read_predictions(shares) if shares else {}
    known = {address_of(champion): champion for champion in champions(trials, inputs)}
    found: dict[str, tuple[ExploiterRow, Champion]] = {}
    for row in rows:
        address = robot_address(row.environment, row.depth, row.trial, row.identity)
        if row.kind == "assessed" and assessed:
            columns = ("environment", "depth", "trial", "identity")
            same = np.all([assessed[name] == getattr(row, name) for name in columns], axis=0)
            design = Designs.from_arrays(assessed)[np.flatnonzero(same)[:1]]
            predicted, true = (np.nan if value is None else value for value in (row.predicted, row.true))
            trial = TrialId("transfer", row.environment, row.depth, row.trial)
            known[address] = Champion(trial, design, predicted, predicted, true)
        if address in known:
            found[address] = row, known[address]
    return found


def films_of_exploiter(
    simulation: SimulationSpec, execution: Execution, row: ExploiterRow, exploiter: Champion, networks: Inputs
) -> list[Filmed]:
    """Return films of an exploiter under the median member, or its own, and of an assessed design in True Slush.

    Args:
        simulation: physics, rollout, and the medium of True Slush.
        execution: the engine.
        row: its row in the ranking.
        exploiter: the design.
        networks: files of every network; if they are missing, there is no film.
    """
    networks = networks_among(networks)
    films = in_true_slush(simulation, execution, [exploiter]) if row.kind == "assessed" else []
    if not networks:
        return films
    trial = exploiter.trial
    single = ENVIRONMENTS[trial.environment].networks == "one"
    member = own_network(trial) if single else median_member(np.array(row.by_member))
    network = NetworkId(environments.data_set_among(networks, trial), member)
    ensemble = environments.ensemble_of(environments.network_among(networks, network))
    environment = ResidualSlush(depth=row.depth, ensemble=ensemble)
    rollouts = environments.roll_out(simulation, execution, environment, exploiter.design, trace=True)
    assert rollouts.trace is not None
    if (rollouts.status == OK).all():
        displacement, trace = float(rollouts.displacement[0, 0]), rollouts.trace[0]
        films.append(Filmed(exploiter, "residual_slush", member, displacement, trace))
    return films


def robot_files(inputs: Inputs, trials: Sequence[TrialId]) -> Files:
    """Return the design file of every champion and every exploiter, by address.

    Args:
        inputs: scores, predictions, and the ranking of exploiters where there is one.
        trials: trials of the champions.
    """
    robots = {address_of(champion): champion for champion in champions(trials, inputs)}
    robots |= {address: exploiter for address, (_, exploiter) in exploiters(inputs, trials).items()}
    return {f"{address}.json": encode_json(design_document(robot.design)) for address, robot in robots.items()}
