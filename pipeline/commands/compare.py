"""puddle compare: what differs between two studies."""

import stat
import textwrap
from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.commands.options import DEFAULT_STORE, StorePath, names_of_studies, with_options
from pipeline.commands.output import to_stderr, to_stdout
from pipeline.errors import PuddleError

if TYPE_CHECKING:
    from pipeline.report.pair_page import StudyPair
    from tasks.analysis.comparison import Group
    from tasks.analysis.study_differences import StudyDifference
    from tasks.analysis.uncertainty import Estimate

_WIDTH = 80
_START_OF_A_PAGE = b"<!doctype html"
_LEGEND = (  # {} is how large a negligible difference may be
    "Mean ± SD over trials [m]; difference with the 95 % interval of Welch's test; Hedges' g; p of Welch's test after "
    "Holm's correction over all rows; where a study has replicates, interval and p include the variance between these. "
    "✓ negligible: the interval lies within {} of what B's designs evolved in True Slush travel; ≠ not negligible: "
    "it lies outside; ? cannot tell, and how many trials each study would need."
)


@with_options
def compare(
    a: Annotated[str, typer.Argument(metavar="A", autocompletion=names_of_studies, help="A study of the store.")],
    b: Annotated[str, typer.Argument(metavar="B", autocompletion=names_of_studies, help="The reference.")],
    out: Annotated[Path | None, typer.Option("--out", help="The page to write, a file that ends in .html.")] = None,
    store: StorePath = DEFAULT_STORE,
    store_b: Annotated[Path | None, typer.Option("--store-b", help="The store of B, if it is another.")] = None,
) -> None:
    """Compare two studies: settings, fitness curves, transfer, and tests of the differences A - B, as one page."""
    from pipeline.results.recorded_study import open_study
    from pipeline.results.study_pair import pair_of

    if out is not None:
        check_page_path(out)
    open_one = partial(open_study, say=to_stderr)
    pair = pair_of(open_one(a, store), open_one(b, store if store_b is None else store_b))
    lines = list(comparison_lines(pair))
    if out is not None:
        from pipeline.report.pair_page import render_pair

        try:
            out.write_bytes(render_pair(pair).encode())
        except OSError as error:
            raise PuddleError(f"--out: can't write {out}: {error.strerror}. Choose another file.") from None
        lines += ["", f"Open: {out.resolve().as_uri()}"]
    for line in lines:
        to_stdout(line)


def check_page_path(out: Path) -> None:
    """Refuse a path where no page can be written, before anything is read.

    Raises:
        PuddleError: it has another suffix, its folder does not exist, or it is there and not an HTML page.
    """
    try:
        if out.suffix.lower() != ".html" or not out.parent.is_dir():
            raise PuddleError(f"--out: expected a file name that ends in .html, in an existing folder, got {out}")
        if not stat.S_ISREG(out.stat().st_mode):  # writing to a pipe would wait for its reader
            raise PuddleError(
                f"--out: expected a new file or a page to replace, got {out}, which is not a regular file"
            )
        with out.open("rb") as file:
            start = file.read(len(_START_OF_A_PAGE))
        if start.lower() != _START_OF_A_PAGE:
            raise PuddleError(f"--out: expected a new file or a page to replace; {out} is not an HTML page")
    except FileNotFoundError:
        pass
    except OSError as error:
        raise PuddleError(f"--out: can't write {out}: {error.strerror}. Choose another file.") from None


def comparison_lines(pair: "StudyPair") -> Iterator[str]:
    """Describe a comparison in lines of 80 columns: the settings that differ, and a row for each test."""
    from pipeline.report.pair_page import INDEPENDENCE, headline
    from tasks.analysis.paper import NEGLIGIBLE_WORDS

    for letter, study in pair.studies:
        yield f"{letter}: study {study.name}" + (f", in {study.store}" if study.store else "")
    yield "Settings that differ (A → B):"
    for name, of_a, of_b in pair.changes:
        text = f"{name}: {of_a} → {of_b}"
        yield from textwrap.wrap(text, _WIDTH, initial_indent="  ", subsequent_indent="    ")
    yield ""
    yield f"{'[m]':<11} {'A':>12} {'B':>12} {'A - B':>22} {'g':>5} {'p':>7}"
    arm = ""
    for row in pair.differences:
        if _arm(row) != arm:
            arm = _arm(row)
            yield f"{arm}, n = {row.a.n} and {row.b.n}{_replicates(row)}"
        yield _row(row)
    yield ""
    yield from textwrap.wrap(f"{headline(pair)}.", _WIDTH)
    for reason, n in Counter(row.judgement.why for row in pair.differences if row.difference.low is None).items():
        yield from textwrap.wrap(f"– {reason} ({n} rows)", _WIDTH)
    yield ""
    yield from textwrap.wrap(_LEGEND.format(NEGLIGIBLE_WORDS), _WIDTH)
    yield ""
    yield from textwrap.wrap(INDEPENDENCE, _WIDTH)


def _arm(row: "StudyDifference") -> str:
    from tasks.world import ENVIRONMENTS

    return f"{ENVIRONMENTS[row.evolved_in].label}, {row.depth:g} m"


def _replicates(row: "StudyDifference") -> str:
    n_a, n_b = row.a.n_replicates, row.b.n_replicates
    return f" in {n_a} and {n_b} replicates" if max(n_a, n_b) > 1 else ""


def _row(row: "StudyDifference") -> str:
    from pipeline.report.page_tables import VERDICT_MARKS
    from pipeline.report.wording import p_value
    from tasks.analysis.equivalence import MOST_TRIALS
    from tasks.analysis.scores import QUANTITY_WORDS

    g = "-" if row.hedges_g.value is None else _short(row.hedges_g.value, 2)
    p = "-" if row.clustered_holm is None else p_value(row.clustered_holm).replace(" ", "")
    mark = VERDICT_MARKS[row.judgement.verdict]
    if (n := row.judgement.n_needed) is not None:
        mark += " >1k" if n > MOST_TRIALS else f" {n:g}"
    means = f"{_spread(row.a):>12} {_spread(row.b):>12} {_interval(row.difference):>22}"
    return f"  {QUANTITY_WORDS[row.quantity]:<9} {means} {g:>5} {p:>7} {mark}"


def _spread(group: "Group") -> str:
    mean = _short(group.mean.value, 1)
    return mean if group.sd is None else f"{mean} ± {_short(group.sd, 1)}"


def _interval(found: "Estimate") -> str:
    value = _short(found.value, 1)
    return value if found.low is None else f"{value} ({_short(found.low, 1)} to {_short(found.high, 1)})"


def _short(value: float | None, n_decimals: int) -> str:
    """Write a number in five characters or fewer where that is possible."""
    if value is None:
        return "-"
    return f"{value:z.{n_decimals if abs(value) < 10 else n_decimals - 1 if abs(value) >= 100 else 1}f}"
