"""Collects the findings of a study from the tables of earlier stages: the analysis, the throws, a champion's family.

Part of the stage report. Where something is missing, its reason is collected instead.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from pipeline.config.settings import Settings
from pipeline.report.data import arm_words
from pipeline.report.findings import (
    Accuracy,
    Ancestor,
    ChampionCoverageRow,
    ChampionRow,
    ExploiterRow,
    Family,
    Findings,
    TankRow,
    ThrowPaths,
)
from pipeline.stages import segments
from pipeline.stages.analyses import specs
from pipeline.stages.analyses.analysis_tables import read_reasons, read_rows, read_table
from pipeline.stages.analyses.champions import MatrixTestRow, matrices_of
from pipeline.stages.analyses.instruments import ThrustRow
from pipeline.stages.collect import read_transitions, throws_among
from pipeline.stages.part import PartId
from pipeline.stages.pilot import PILOTED, PilotId, read_coverage
from pipeline.stages.proposed_design import ANALYSED
from pipeline.store.encoding import decode_table
from pipeline.workflow.identity import TrialId, deepest_first, trials_of
from pipeline.workflow.stage import Files, Inputs
from tasks.analysis.against_paper import Row, with_tank_tests
from tasks.analysis.attribution import Attribution
from tasks.analysis.comparison import Contrast
from tasks.analysis.coverage import CoverageRow
from tasks.analysis.member_error import MemberError
from tasks.analysis.prediction import Histograms, Regression, is_member, mean_of_ensemble
from tasks.analysis.variance_split import VarianceRow
from tasks.arrays import Float64
from tasks.design import Designs
from tasks.design.genes import GENES
from tasks.evolution import OPERATORS
from tasks.residual import split_throws
from tasks.world import EnvironmentName

HISTORIES = "history"  # role of the inputs that are segments of the trial whose champion's family is shown


def findings(inputs: Inputs, settings: Settings, family: TrialId | None) -> Findings:
    """Return what the page shows.

    Args:
        inputs: the page's inputs.
        settings: the study's settings.
        family: the trial whose champion's family is shown.
    """
    analysed = {name.chain: files for name, files in inputs.items() if name.role == ANALYSED}
    statistics = analysed.get(PartId(specs.STATISTICS), {})
    arms = {arm_words(arm.environment, arm.depth): arm for arm in deepest_first(trials_of(settings, "transfer"))}
    instruments, tanks = (
        {words: files for words, arm in arms.items() if (files := analysed.get(PartId(kind, arm)))}
        for kind in (specs.INSTRUMENTS, specs.TANK)
    )
    ensemble = instruments.get(arm_words("residual_slush", settings.assessed_depth), {})
    missing = {
        field: reason
        for field, (kind, table) in _SOURCES.items()
        if (reason := _reason(analysed.get(PartId(kind)), table)) is not None
    }
    for files in instruments.values():
        for table in ("champions", "champion_coverage"):
            if (reason := _reason(files, table)) is not None:
                missing[table] = reason
    if ensemble and (reason := _reason(ensemble, "member_errors")) is not None:
        missing["member_errors"] = reason
    traced = _family(inputs, family) if family else None
    if family and traced is None:
        missing["family"] = "every design of the trial diverged"
    tests = read_rows(analysed.get(PartId(specs.MATRIX)), "tests", MatrixTestRow)
    thrusts = read_rows(analysed.get(PartId(specs.MEMBERS)), "phantom_thrust", ThrustRow)
    tank_tests = {words: read_rows(files, "tank", TankRow) for words, files in tanks.items()}
    return Findings(
        throws=_throws(throws_among(inputs), settings),
        coverage=_coverage(inputs),
        accuracy=_accuracy(statistics, settings),
        other_regressions=[
            row for row in read_rows(statistics, "regressions", Regression) if not _is_main(row, settings)
        ],
        against_paper=_against_paper(statistics, tank_tests),
        contrasts=read_rows(statistics, "contrasts", Contrast),
        attributions=read_rows(statistics, "attribution", Attribution),
        variances=read_rows(statistics, "variance", VarianceRow),
        transfer_matrices=matrices_of(tests),
        exploiters=read_rows(analysed.get(PartId(specs.EXPLOITERS)), "exploiters", ExploiterRow),
        champions={words: read_rows(files, "champions", ChampionRow) for words, files in instruments.items()},
        champion_coverage={
            (arms[words].environment, arms[words].depth): rows
            for words, files in instruments.items()
            if (rows := read_rows(files, "champion_coverage", ChampionCoverageRow))
        },
        phantom_thrust=[row.thrust for row in thrusts],
        member_errors=read_rows(ensemble, "member_errors", MemberError),
        family=traced,
        tank=settings.tank,
        objective=settings.evolution.objective,
        selected_for=settings.selected_for,
        tank_tests=tank_tests,
        missing=missing,
    )


def _against_paper(statistics: Files, tank_tests: Mapping[str, Sequence[TankRow]]) -> Sequence[Row]:
    """Return the comparison with the paper, with the tank tests of the first arm that proposes a robot to build."""
    rows = read_rows(statistics, "paper", Row)
    proposed = next((row for of_arm in tank_tests.values() for row in of_arm if row.proposed), None)
    if proposed is None:
        return rows
    return with_tank_tests(rows, wet=proposed.wet_trials, dry=proposed.dry_trials, dry_servo=proposed.dry_servo_trials)


_SOURCES: Mapping[str, tuple[str, str]] = {
    "accuracy": (specs.STATISTICS, "regressions"),
    "against_paper": (specs.STATISTICS, "paper"),
    "contrasts": (specs.STATISTICS, "contrasts"),
    "attributions": (specs.STATISTICS, "attribution"),
    "transfer_matrices": (specs.MATRIX, "matrix"),
    "exploiters": (specs.EXPLOITERS, "exploiters"),
    "phantom_thrust": (specs.MEMBERS, "phantom_thrust"),
}
"""Work item and table by field of Findings; the item may state why the table is empty."""


def _reason(files: Files | None, table: str) -> str | None:
    return "its analysis is not done" if files is None else read_reasons(files).get(table)


def _throws(chunks: Sequence[Files], settings: Settings) -> ThrowPaths | None:
    """Arrange the transitions of throws as paths; steps that tracked throws lack are NaN."""
    if not chunks:
        return None
    table = read_transitions(chunks)
    throws, first, number = np.unique(table.throw, return_index=True, return_inverse=True)
    path = np.full((len(throws), int(table.step.max()) + 1, 3), np.nan)
    path[number, table.step] = table.state[:, :3]
    lengths = table.length_scale[first].astype(np.float64)
    learned, _ = split_throws(throws, settings.training.held_out, seed=settings.seed)
    seconds = path.shape[1] * settings.physics.time_step
    return ThrowPaths(lengths, path, seconds=seconds, n_learned=int(learned.sum()))


def _coverage(inputs: Inputs) -> dict[str, dict[EnvironmentName, list[CoverageRow]]]:
    """Return the coverage of the first replicate of each data set."""
    pilots = {name.chain: files for name, files in inputs.items() if name.role == PILOTED}
    return {
        pilot.data_set.words: read_coverage(files)
        for pilot, files in pilots.items()
        if isinstance(pilot, PilotId) and pilot.data_set.replicate == 0
    }


def _is_main(row: Regression, settings: Settings) -> bool:
    return row.learned_from == settings.throw_groups[0]


def _accuracy(files: Files, settings: Settings) -> Accuracy | None:
    regressions = [row for row in read_rows(files, "regressions", Regression) if _is_main(row, settings)]
    if not regressions:
        return None
    table = read_table(files, "histograms")
    means = ("mean", *map(mean_of_ensemble, settings.throw_groups[1:]))
    shown = [i for i, name in enumerate(table["name"]) if name in means or is_member(name)]
    if not shown:
        return None
    names, edges = tuple(table["name"][shown].tolist()), table["edges"][0]
    counts = table["counts"][shown].reshape(len(shown), len(edges) - 1, -1)
    return Accuracy(
        settings.assessed_depth, regressions, Histograms(names, edges, counts, table["n_outside"][shown], None)
    )


def _family(inputs: Inputs, trial: TrialId) -> Family | None:
    """Trace the fittest design of a trial back to the random designs from which it descends."""
    tables = [
        decode_table(files[segments.HISTORY], schema="history", version=1, source=name.label)
        for name, files in inputs.items()
        if name.role == HISTORIES
    ]
    history = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    if not np.isfinite(history["fitness"]).any():
        return None
    place = {identity: row for row, identity in enumerate(history["identity"].tolist())}
    genes = _gene_matrix(Designs.from_arrays(history))
    waiting = [int(history["identity"][np.argmax(history["fitness"])])]
    found: dict[int, Ancestor] = {}
    while waiting:
        identity = waiting.pop()
        if identity in found:
            continue
        row = place[identity]
        parents = tuple(parent for parent in history["parents"][row].tolist() if parent >= 0)
        changed = [int((genes[row] != genes[place[parent]]).sum()) for parent in parents]
        found[identity] = Ancestor(
            identity,
            generation=int(history["generation"][row]),
            age=int(history["age"][row]),
            operator=OPERATORS[history["operator"][row]],
            parents=parents,
            fitness=float(history["fitness"][row]),
            n_genes_changed=min(changed, default=None),
        )
        waiting += parents
    label = f"{arm_words(trial.environment, trial.depth)}, trial {trial.index}"
    return Family(label, [found[identity] for identity in sorted(found)])


def _gene_matrix(designs: Designs) -> Float64:
    """Return designs as (n_designs, n_genes), without the joint of the root, which has no effect."""
    first_link = {"parent": 1, **{gene.name: gene.first_link for gene in GENES}}
    columns = (genes.reshape(len(designs), -1)[:, first_link[name] :] for name, genes in designs.arrays())
    return np.concatenate([column.astype(np.float64) for column in columns], axis=1)
