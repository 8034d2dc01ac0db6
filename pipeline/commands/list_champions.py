"""puddle champions: the champions of a study, ranked."""

from collections.abc import Iterator
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
    """Print a table for each depth, the deepest first, and name the trials without a champion.

    Raises:
        PuddleError: no trial has been transferred yet.
    """
    rows = study.champions().to_pylist()
    if not rows:
        why = "no trial has been transferred to True Slush yet, or every design diverged"
        raise PuddleError(f"study {study.name} has no champions: {why}")
    yield f"study {study.name}: champions by zero-shot displacement in True Slush [m]"
    yield f"selected for: {study.settings.selected_for}"
    for depth in sorted({row["depth"] for row in rows}, reverse=True):
        yield f"\n{f'{depth:g} m':>6}  {'evolved in':<22} trial predicted     σ fitness zero-shot  adapted"
        here = [row for row in rows if row["depth"] == depth]
        ranked = sorted(here, key=lambda row: -(row["zero_shot"] if row["zero_shot"] is not None else -float("inf")))
        for rank, row in enumerate(ranked, 1):
            values = " ".join(_number(row[name], width) for name, width in _COLUMNS.items())
            yield f"{rank:>6}  {row['environment']:<22} {row['trial']:>5} {values}"
    n_without = len(study.settings.grid.trials()) - len(rows)
    if n_without:
        yield f"\n{n_without} of {len(rows) + n_without} trials have no champion yet, or every design diverged."
    yield f"\n`puddle export {study.name} --out DIR` writes the design file of each."


_COLUMNS = {"predicted": 9, "predicted_sd": 5, "fitness": 7, "zero_shot": 9, "adapted": 8}  # and their widths


def _number(value: float | None, width: int) -> str:
    return f"{'-':>{width}}" if value is None else f"{value:z{width}.2f}"
