"""puddle champions: the champions of a study, ranked."""

from collections.abc import Iterator
from math import isnan
from typing import TYPE_CHECKING

from pipeline.commands.options import DEFAULT_STORE, StorePath, StudyName
from pipeline.commands.output import to_stderr, to_stdout
from pipeline.errors import PuddleError

if TYPE_CHECKING:
    from pipeline.results.recorded_study import Study


def list_champions(study: StudyName, store: StorePath = DEFAULT_STORE) -> None:
    """Rank the champions of a study by their displacement in True Slush, at each depth."""
    from pipeline.results.recorded_study import open_study

    for line in champion_lines(open_study(str(study), store, say=to_stderr)):
        to_stdout(line)


def champion_lines(study: "Study") -> Iterator[str]:
    """Print the champions, the greatest depth and the best first, and count the trials without one.

    Raises:
        PuddleError: no trial has been transferred yet.
    """
    from pipeline.report.render import as_text
    from tasks.analysis.scores import ScoredTrial

    rows = [row for row in study.trials() if row.status == "ok"]
    if not rows:
        why = "no trial has been transferred to True Slush yet, or every design diverged"
        raise PuddleError(f"study {study.name} has no champions: {why}")
    yield f"study {study.name}: champions by zero-shot displacement in True Slush"
    yield f"selected for: {study.settings.selected_for}"
    ranked = sorted(rows, key=lambda row: (-row.depth, isnan(row.zero_shot), -row.zero_shot))
    yield from as_text(ScoredTrial, ranked, without=("status",))
    if n_without := len(study.settings.grid.trials()) - len(rows):
        yield f"\n{n_without} of {len(rows) + n_without} trials have no champion yet, or every design diverged."
    yield f"\n`puddle export {study.name} --out DIR` writes the design file of each."
