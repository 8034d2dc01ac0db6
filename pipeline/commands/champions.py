"""puddle champions: the best design of each trial of a study."""

from math import isnan

from pipeline.commands.options import DEFAULT_STORE, StorePath, StudyArgument, to_copy, with_options
from pipeline.commands.terminal import to_stderr, to_stdout
from pipeline.errors import PuddleError
from pipeline.report.render import as_text
from pipeline.results.recorded_study import open_study
from tasks.analysis.columns import scored_by
from tasks.analysis.scores import ScoredTrial


@with_options
def champions(study: StudyArgument, store: StorePath = DEFAULT_STORE) -> None:
    """Rank a study's champions by their score in the target."""
    opened = open_study(study, store, say=to_stderr)
    objective = opened.settings.evolution.maximised
    rows = [row for row in opened.trials() if row.status == "ok"]
    if not rows:
        why = f"no trial has been transferred to {opened.settings.target_label} yet, or every design diverged"
        raise PuddleError(f"study {opened.name} has no champions: {why}")
    ranked = sorted(rows, key=lambda row: (-row.depth, isnan(row.zero_shot), -row.zero_shot))
    to_stdout(
        f"study {opened.name}: champions by zero-shot {objective.label.lower()} in {opened.settings.target_label}",
        f"selected for: {opened.settings.selected_for}",
        *as_text(scored_by(objective, ScoredTrial), ranked, without=("status",), learners=opened.settings.arm_learners),
    )
    if n_without := len(opened.settings.trials()) - len(rows):
        to_stdout(f"\n{n_without} of {len(rows) + n_without} trials have no champion yet, or every design diverged.")
    export_them = to_copy(f"export {opened.name} --out {opened.name}", store)
    to_stdout(f"\n`{export_them}` writes the design file of each.")
