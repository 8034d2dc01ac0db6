"""puddle compare: what differs between two studies, or between two arms of one."""

import textwrap
from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.commands.options import DEFAULT_STORE, StorePath, StudyArgument, names_of_studies, with_options
from pipeline.commands.output import to_stderr, to_stdout
from pipeline.errors import PuddleError

if TYPE_CHECKING:
    from pipeline.report.comparison_page import Compared

_WIDTH = 110


@with_options
def compare(
    a: StudyArgument,
    b: Annotated[
        str | None, typer.Argument(metavar="[B]", autocompletion=names_of_studies, help="The reference, a study.")
    ] = None,
    arms: Annotated[
        tuple[str, str] | None, typer.Option("--arms", help="Two arms of one study, such as designed_throws dry_land.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Write the table, too: .html, .md, .tex, .csv or .json.")
    ] = None,
    store: StorePath = DEFAULT_STORE,
    store_b: Annotated[Path | None, typer.Option("--store-b", help="The store of B, if it is another.")] = None,
) -> None:
    """Compare two studies arm by arm, or two arms of one study: the difference A - B, its interval, and a verdict."""
    from pipeline.report.comparison_page import SUFFIXES, written_comparison
    from pipeline.results.comparisons import compare_arms, compare_studies
    from pipeline.results.recorded_study import open_study
    from pipeline.store import disk

    if (b is None) == (arms is None):
        raise PuddleError("expected two studies, or one study and --arms A B")
    if out is not None and (out.suffix not in SUFFIXES or not out.parent.is_dir() or out.exists()):
        expected = f"a new file that ends in {', '.join(SUFFIXES)}, in an existing folder"
        raise PuddleError(f"--out: expected {expected}, got {out}{', which exists' if out.exists() else ''}")
    opened = partial(open_study, say=to_stderr)
    if arms is not None:
        compared = compare_arms(opened(a, store), *arms)
    else:
        compared = compare_studies(opened(a, store), opened(str(b), store if store_b is None else store_b))
    for line in comparison_lines(compared):
        to_stdout(line)
    if out is not None:
        with disk.explained("writing the comparison", out, advice="choose another file"):
            out.write_text(written_comparison(compared, out.suffix), encoding="utf-8")
        to_stdout(f"\nWritten: {out}")


def comparison_lines(compared: "Compared") -> Iterator[str]:
    """Describe a comparison: the settings that differ, and a row for each test."""
    from pipeline.report.render import as_text
    from tasks.analysis.comparison import VERDICTS, Comparison

    yield f"A: {compared.a}; B: {compared.b}, the reference"
    for name, of_a, of_b in compared.changes:
        text = f"{name}: {of_a} → {of_b}"
        yield from textwrap.wrap(text, _WIDTH, initial_indent="  ", subsequent_indent="    ")
    if compared.caution:
        yield compared.caution
    yield ""
    yield from as_text(Comparison, compared.rows, compared.without, width=_WIDTH)
    counts = Counter(row.verdict for row in compared.rows)
    listed = ", ".join(f"{counts[verdict]} {verdict}" for verdict in VERDICTS if counts[verdict])
    yield f"\n{len(compared.rows)} comparisons: {listed}. They agree if the interval lies within what is negligible."
