"""The comparison of two recorded studies, or of two arms of one, and the file that `puddle compare` writes of it."""

import json
from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.errors import PuddleError
from pipeline.report.document import TEMPLATES, document
from pipeline.report.render import WRITERS, as_html
from pipeline.results.recorded_study import Study
from pipeline.workflow.record import setting_changes
from tasks.analysis.columns import scored_by
from tasks.analysis.comparison import Comparison, compare
from tasks.analysis.scores import QUANTITIES, arms
from tasks.evolution import OBJECTIVES, PAPERS_OBJECTIVE, Objective
from tasks.residual import arm_kind, in_order
from tasks.world import ENVIRONMENTS

SUFFIXES = (".html", *WRITERS)
SAID_ABOVE = ("b",)  # column that a heading makes superfluous: B is the same study or arm in every row


@dataclass(frozen=True)
class Compared:
    """The rows of a comparison, and what a reader has to know of it."""

    title: str
    a: str  # what A is
    b: str  # what B is, the reference
    changes: Sequence[tuple[str, str, str]]  # settings that differ: name, value in A, value in B
    rows: Sequence[Comparison]
    objective: Objective  # what is compared: displacement, if A and B have different ones
    caution: str = ""


def compare_arms(study: Study, a: str, b: str) -> Compared:
    """Compare two arms of a study at every depth that both have.

    Raises:
        PuddleError: the study has no such arm, or the two have no champions at a common depth.
    """
    if a == b:
        raise PuddleError(f"--arms: expected two arms, got {a} twice")
    names = dict.fromkeys(name for name, _, _ in study.settings.trials())
    for arm in (a, b):
        if arm not in names:
            raise PuddleError(f"--arms: expected arms of study {study.name} ({', '.join(names)}), got {arm!r}")
    trials = study.trials()
    rows = compare(trials, trials, [((a, quantity), (b, quantity)) for quantity in QUANTITIES], study.settings.target)
    if not rows:
        raise PuddleError(f"study {study.name}: {a} and {b} have no champions at the same depth yet")
    label_a, label_b = (arm_kind(arm).label for arm in (a, b))
    title, objective = f"{label_a} against {label_b} in study {study.name}", study.settings.evolution.maximised
    return Compared(title, label_a, label_b, (), rows, objective)


def compare_studies(a: Study, b: Study) -> Compared:
    """Compare study A with study B, the reference: each arm with the same arm, at every common depth.

    Raises:
        PuddleError: the two are one, or have no champions of the same environment at the same depth.
    """
    if (a.store.root, a.name) == (b.store.root, b.name):
        raise PuddleError(f"expected two studies, got study {a.name} twice")
    of_a, of_b = (study.settings.model_dump(mode="json", exclude={"name", "work"}) for study in (a, b))
    changes = [(name, json.dumps(new), json.dumps(old)) for name, old, new in setting_changes(of_b, of_a)]
    objectives = {(study.settings.evolution.maximised.name, study.settings.objective_depths) for study in (a, b)}
    objective = b.settings.evolution.maximised if len(objectives) == 1 else OBJECTIVES[PAPERS_OBJECTIVE]
    trials_a, trials_b = (study.trials(displacement=objective.is_papers) for study in (a, b))
    scored = [(name, quantity) for name in in_order(trial.environment for trial in trials_a) for quantity in QUANTITIES]
    pairs = [(arm, arm) for arm in scored if arm != (b.settings.target, "predicted")]  # which is zero-shot
    rows = compare(trials_a, trials_b, pairs, b.settings.target)
    if not rows:
        listed = [
            ", ".join(f"{name} at {depth:g} m" for name, depth in arms(trials)) for trials in (trials_a, trials_b)
        ]
        raise PuddleError(
            f"studies {a.name} and {b.name} have no champions of the same environment at the same depth: expected "
            f"some in both, got {listed[0] or 'none'} in {a.name} and {listed[1] or 'none'} in {b.name}"
        )
    used = {name for study in (a, b) for name in (study.settings.target, *study.settings.grid.environments)}
    groups = (ENVIRONMENTS[name].settings_group if name in ENVIRONMENTS else name for name in used)
    of_displacement = ("physics.", "rollout.", *(f"{group}." for group in groups))
    physical = [name for name, _, _ in changes if name == "target" or name.startswith(of_displacement)]
    caution = f"They differ in what a displacement is: {', '.join(physical)}." if physical else ""
    names = f"study {a.name}", f"study {b.name}"
    return Compared(f"{a.name} against {b.name}", *names, changes, rows, objective, caution)


def written_comparison(compared: Compared, suffix: str) -> str:
    """Return the content of a file that ends in one of SUFFIXES: a page, or the table alone."""
    kind = scored_by(compared.objective, Comparison)
    if suffix in WRITERS:
        return WRITERS[suffix](kind, compared.rows, ". ".join(filter(None, (compared.title, compared.caution))))
    table = as_html(kind, compared.rows, "Differences between A and B", without=SAID_ABOVE)
    body = TEMPLATES.get_template("comparison.html").render(compared=compared, table=table)
    return document(title=compared.title, policy="script-src 'none'; img-src data:", body=body)
