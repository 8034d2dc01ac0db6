"""Champions, and the tables that compare them: the transfer matrix, and the designs that exploit the ensemble.

Part of the stage analyse, whose page lists the tables.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pipeline.report.findings import ExploiterRow
from pipeline.stages import environments
from pipeline.stages.analyses.analysis_tables import Reasons, Tables
from pipeline.stages.analyses.specs import ExploitersSpec, MatrixSpec
from pipeline.stages.assess import assessed_among, read_predictions
from pipeline.stages.transfer import CHAMPION, SCORE, SCORED
from pipeline.stages.trial_scores import decode_scores
from pipeline.store.design_file import design_from
from pipeline.store.encoding import decode_json
from pipeline.store.tables import columns_of
from pipeline.workflow.identity import InputName, TrialId
from pipeline.workflow.stage import Inputs, Job
from tasks.analysis.attribution import TransferMatrix, transfer_matrix
from tasks.analysis.hallucination import Exploiter, rank_exploiters
from tasks.arrays import Float64
from tasks.design import Designs
from tasks.design.genes import concatenate
from tasks.evolution import disagreement
from tasks.world import ENVIRONMENTS, EnvironmentName, ResidualSlush


@dataclass(frozen=True)
class Champion:
    """The champion of a trial with its scores from the stage transfer."""

    trial: TrialId
    design: Designs
    fitness: float  # where it evolved, in the objective's unit
    predicted: float  # displacement where it evolved [m]: the mean over the members of an ensemble
    zero_shot: float  # displacement in True Slush [m]; NaN where diverged


def champions(trials: Sequence[TrialId], inputs: Inputs) -> list[Champion]:
    """Read the champions of trials; trials that failed or have no champion are left out."""
    found = []
    for trial in trials:
        files, label = inputs.get(InputName(SCORED, trial), {}), trial.label
        if SCORE in files and (scores := decode_scores(files[SCORE], label)) is not None:
            design = design_from(decode_json(files[CHAMPION], label), label)
            found.append(Champion(trial, design, scores.fitness, scores.predicted, scores.zero_shot))
    return found


@dataclass(frozen=True)
class MatrixTestRow:
    """A champion of one depth tested at another, in True Slush; lengths in m."""

    environment: EnvironmentName
    trained: float
    trial: int
    tested: float
    displacement: float
    com_displacement: float


@dataclass(frozen=True)
class CellRow:
    """A cell of an environment's transfer matrix; see TransferMatrix."""

    environment: str
    trained: float
    tested: float
    mean: float
    sd: float
    n: int
    relative: float


def matrices_of(tests: Sequence[MatrixTestRow]) -> dict[EnvironmentName, TransferMatrix]:
    """Return the transfer matrix of each environment."""
    by_environment: dict[EnvironmentName, list[MatrixTestRow]] = {}
    for row in tests:
        by_environment.setdefault(row.environment, []).append(row)
    return {
        name: transfer_matrix(
            [row.trained for row in rows], [row.tested for row in rows], np.array([row.displacement for row in rows])
        )
        for name, rows in by_environment.items()
    }


def compute_matrix(job: Job[MatrixSpec], inputs: Inputs) -> tuple[Tables, Reasons]:
    """Test every champion at every depth of the grid, in True Slush."""
    spec = job.spec
    entrants = champions(spec.trials, inputs)
    tests: list[MatrixTestRow] = []
    for depth in spec.depths if entrants else ():
        true_slush = environments.true_slush(spec.simulation.media, depth)
        designs = concatenate([champion.design for champion in entrants])
        rollouts = environments.roll_out(spec.simulation, job.execution, true_slush, designs)
        tests += [
            MatrixTestRow(
                champion.trial.environment, champion.trial.depth, champion.trial.index, depth, float(root), float(whole)
            )
            for champion, root, whole in zip(entrants, rollouts.displacement, rollouts.com_displacement, strict=True)
        ]
    cells: list[CellRow] = []
    for environment, matrix in matrices_of(tests).items():
        for i, j in np.ndindex(matrix.mean.shape):
            mean, sd, relative = (float(statistic[i, j]) for statistic in (matrix.mean, matrix.sd, matrix.relative))
            depths = float(matrix.trained[i]), float(matrix.tested[j])
            cells.append(CellRow(environment, *depths, mean, sd, int(matrix.n[i, j]), relative))
    reasons = {}
    if not entrants:
        reasons = dict.fromkeys(("tests", "matrix"), "no trial has a champion")
    elif len(spec.depths) == 1:
        reasons["matrix"] = "a single depth: the matrix has one column"
    return {"tests": columns_of(MatrixTestRow, tests), "matrix": columns_of(CellRow, cells)}, reasons


@dataclass(frozen=True)
class Candidate:
    """A design, its predicted and its true displacement [m]; NaN where it diverged."""

    kind: Literal["champion", "assessed"]
    environment: EnvironmentName
    depth: float
    trial: int
    generation: int
    identity: int
    predicted: float
    true: float
    by_member: Float64  # (n_members,)


def compute_exploiters(job: Job[ExploitersSpec], inputs: Inputs) -> tuple[Tables, Reasons]:
    """Rank every champion and every assessed design by the mean prediction of the ensemble minus the truth."""
    why = job.spec.no_networks
    suspects = [] if why else [*_champions_under_members(job, inputs), *_assessed(inputs)]
    by_member = np.array([s.by_member for s in suspects]).reshape(len(suspects), -1 if suspects else 1)
    ranked = rank_exploiters(
        np.array([s.predicted for s in suspects]),
        np.array([s.true for s in suspects]),
        disagreement(by_member, job.spec.deviation),
    )
    rows = [_exploiter_row(row, suspects[row.design]) for row in ranked]
    reason = why or ("" if suspects else "no trial has a champion and no design was assessed")
    return {"exploiters": columns_of(ExploiterRow, rows)}, {"exploiters": reason} if reason else {}


def _exploiter_row(row: Exploiter, candidate: Candidate) -> ExploiterRow:
    ranking = (row.predicted, row.true, row.excess, row.disagreement, row.ranked_by, row.reason)
    who = (
        candidate.kind,
        candidate.environment,
        candidate.depth,
        candidate.trial,
        candidate.generation,
        candidate.identity,
    )
    return ExploiterRow(row.rank, *who, *ranking, by_member=tuple(candidate.by_member.tolist()))


def _champions_under_members(job: Job[ExploitersSpec], inputs: Inputs) -> list[Candidate]:
    """Simulate champions of all environments under the members of an ensemble, at the depth where they evolved."""
    spec = job.spec
    entrants = champions(spec.trials, inputs)
    data_sets = {champion.trial: environments.data_set_among(inputs, champion.trial) for champion in entrants}
    suspects = []
    for depth, data_set in dict.fromkeys((champion.trial.depth, data_sets[champion.trial]) for champion in entrants):
        here = [
            champion for champion in entrants if (champion.trial.depth, data_sets[champion.trial]) == (depth, data_set)
        ]
        ensemble = environments.ensemble_of(environments.ensemble_among(inputs, data_set))
        environment = ResidualSlush(depth=depth, ensemble=ensemble)
        designs = concatenate([champion.design for champion in here])
        by_member = environments.roll_out(spec.simulation, job.execution, environment, designs).displacement.T
        predicted = by_member.mean(axis=1)  # NaN where a member's rollout diverged
        for champion, each, prediction in zip(here, by_member, predicted, strict=True):
            trial = champion.trial
            own = champion.predicted if ENVIRONMENTS[trial.environment].networks == "one" else prediction
            suspects.append(
                Candidate(
                    "champion", trial.environment, depth, trial.index, -1, -1, float(own), champion.zero_shot, each
                )
            )
    return suspects


def _assessed(inputs: Inputs) -> list[Candidate]:
    shares = assessed_among(inputs)
    if not shares:
        return []
    table = read_predictions(shares)
    predicted = table["predicted"].mean(axis=1)
    columns = (table[name].tolist() for name in ("environment", "depth", "trial", "generation", "identity"))
    rows = zip(*columns, predicted.tolist(), table["true"].tolist(), table["predicted"], strict=True)
    return [Candidate("assessed", *row) for row in rows]
