"""puddle compare: whether two studies, or two arms of one, differ."""

from collections import Counter
from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import DEFAULT_STORE, StorePath, StudyArgument, output_suffix, with_options
from pipeline.commands.terminal import to_stderr, to_stdout
from pipeline.errors import PuddleError
from pipeline.report.render import MARKS, as_text
from pipeline.results.comparisons import SAID_ABOVE, SUFFIXES, compare_arms, compare_studies, written_comparison
from pipeline.results.recorded_study import open_study
from pipeline.store import disk
from tasks.analysis.columns import scored_by
from tasks.analysis.comparison import Comparison

_LINE_LENGTH = 110


@with_options
def compare(
    a: StudyArgument,
    b: Annotated[str | None, typer.Argument(metavar="[B]", help="The reference, a study.")] = None,
    arms: Annotated[
        tuple[str, str] | None, typer.Option("--arms", help="Two arms of one study, such as designed_throws dry_land.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Write the table, too: .html, .md, .tex, .csv or .json.")
    ] = None,
    store: StorePath = DEFAULT_STORE,
) -> None:
    """Compare two studies, or two arms of one.

    Each arm is compared with the same arm at every depth: the difference A - B, its interval, and a verdict.
    """
    if (b is None) == (arms is None):
        raise PuddleError("expected two studies, or one study and --arms A B")
    suffix = "" if out is None else output_suffix(out, SUFFIXES, replaces=False)
    first = open_study(a, store, say=to_stderr)
    compared = (
        compare_studies(first, open_study(str(b), store, say=to_stderr)) if arms is None else compare_arms(first, *arms)
    )
    to_stdout(f"A: {compared.a}; B: {compared.b}, the reference")
    to_stdout(*(f"  {name}: {of_a} → {of_b}" for name, of_a, of_b in compared.changes))
    kind = scored_by(compared.objective, Comparison)
    to_stdout(compared.caution, *as_text(kind, compared.rows, SAID_ABOVE, width=_LINE_LENGTH))
    counts = Counter(row.verdict for row in compared.rows)
    listed = ", ".join(f"{counts[verdict]} {verdict}" for verdict in MARKS if counts[verdict])
    to_stdout(
        f"\n{len(compared.rows)} comparisons: {listed}. They agree if the interval lies within what is "
        f"negligible, and differ if it lies outside and p is below 5 %."
    )
    if out is not None:
        disk.write(out, written_comparison(compared, suffix).encode())
        to_stdout(f"\nWritten: {out}")
