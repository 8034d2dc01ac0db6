"""Two recorded studies, read for their comparison."""

import json

import numpy as np

from pipeline.errors import PuddleError
from pipeline.report.data import TrialResult
from pipeline.report.pair_page import ComparedStudy, StudyPair
from pipeline.results.recorded_study import Study
from pipeline.store.provenance import environment as provenance
from pipeline.workflow.record import setting_changes
from tasks.analysis.study_differences import compare_studies

_OF_DISPLACEMENT = ("physics", "slush", "rollout")
"""Settings groups that decide what a displacement in True Slush is."""


def pair_of(a: Study, b: Study) -> StudyPair:
    """Compare study A with study B, the reference.

    Raises:
        PuddleError: the two are one, their displacements can't be compared, or there is nothing in common.
    """
    changes = _changes(a, b)
    _check_grids(a, b)
    trials = [_trials(study) for study in (a, b)]
    for study, results in zip((a, b), trials, strict=True):
        if not results:
            raise PuddleError(
                f"study {study.name} has no champions: no trial has been transferred to True Slush yet, or every "
                f"design diverged"
            )
    differences = compare_studies(a.scores(), b.scores())
    if not differences:
        raise PuddleError(
            f"studies {a.name} and {b.name} have no champions of the same environment at the same depth yet: expected "
            f"some in both"
        )
    same_store = a.store.root == b.store.root
    first, second = (
        ComparedStudy(
            study.name,
            "" if same_store else str(study.store.root),
            results,
            study.settings.evolution.objective,
            study.settings.selected_for,
        )
        for study, results in zip((a, b), trials, strict=True)
    )
    return StudyPair(first, second, changes, differences, dict(provenance()))


def _changes(a: Study, b: Study) -> list[tuple[str, str, str]]:
    """Return each setting that differs but the name, and its values in A and B; refuse what can't be compared."""
    if (a.store.root, a.name) == (b.store.root, b.name):
        raise PuddleError(f"expected two studies, got study {a.name} twice; --store-b names another store for B")
    of_a, of_b = (study.settings.model_dump(mode="json", exclude={"name"}) for study in (a, b))
    changes = setting_changes(of_a, of_b)
    physical = [str(change) for change in changes if change.name.split(".")[0] in _OF_DISPLACEMENT]
    if physical:
        raise PuddleError(
            f"studies {a.name} and {b.name} differ in what a displacement is ({'; '.join(physical)}): expected equal "
            f"settings of {', '.join(_OF_DISPLACEMENT)}"
        )
    if all(change.name.split(".")[0] == "work" for change in changes):
        raise PuddleError(
            f"studies {a.name} and {b.name} have the same settings and so the same trials: expected another seed, or "
            f"another value of a setting"
        )
    return [(change.name, json.dumps(change.old), json.dumps(change.new)) for change in changes]


def _check_grids(a: Study, b: Study) -> None:
    """Refuse studies without a common depth, or without a common environment at one."""
    arms = [{(environment, depth) for environment, depth, _ in study.settings.grid.trials()} for study in (a, b)]
    if arms[0] & arms[1]:
        return
    depths = [study.settings.grid.depths for study in (a, b)]
    common = set(depths[0]) & set(depths[1])
    if not common:
        listed = [", ".join(f"{depth:g}" for depth in study_depths) for study_depths in depths]
        name, what = "grid.depths", f"{listed[0]} m in study {a.name} and {listed[1]} m in study {b.name}"
    else:
        listed = [
            ", ".join(sorted({environment for environment, depth in study_arms if depth in common}))
            for study_arms in arms
        ]
        name, what = "grid.environments", f"{listed[0]} in study {a.name} and {listed[1]} in study {b.name}"
    raise PuddleError(f"{name}: expected some in common, got {what}")


def _trials(study: Study) -> list[TrialResult]:
    """Return the champions of a study, each with its fitness curve if the study has it."""
    champions = study.champions().to_pylist()
    curves: dict[tuple[str, float, int], list[float]] = {}
    if champions and "fitness_curves" in study.tables:
        table = study.table("fitness_curves").select(["environment", "depth", "trial", "best_fitness"])
        for environment, depth, trial, best in zip(*table.to_pydict().values(), strict=True):
            curves.setdefault((environment, depth, trial), []).append(best)
    return [
        TrialResult(
            row["environment"],
            row["depth"],
            row["trial"],
            predicted=np.nan if row["predicted"] is None else row["predicted"],
            zero_shot=row["zero_shot"],
            adapted=row["adapted"],
            predicted_sd=row["predicted_sd"],
            fitness=row["fitness"],
            curve=np.array(curves.get((row["environment"], row["depth"], row["trial"]), []), dtype=np.float64),
        )
        for row in champions
    ]
