"""puddle suggest-throws: which throws would teach the networks most."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import DEFAULT_STORE, StorePath, names_of_studies, with_options
from pipeline.commands.output import to_stdout


@with_options
def suggest_throws(
    study: Annotated[
        str, typer.Option("--study", metavar="NAME", autocompletion=names_of_studies, help="A study of the store.")
    ],
    n: Annotated[int, typer.Option("--n", help="Number of throws.")] = 20,
    throws: Annotated[
        str | None,
        typer.Option("--throws", help="Settings group of the throws made so far: throws or designed_throws."),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Write the starts (.csv).")] = None,
    store: StorePath = DEFAULT_STORE,
) -> None:
    """List the starts of throws that would teach a study's networks most.

    Half of them are states that robots pass through, where the members disagree far from every throw. The other half
    covers the range of robots' states evenly.
    """
    from pipeline.results.recorded_study import open_study
    from pipeline.results.suggested_throws import as_csv, as_lines, suggested_throws
    from pipeline.store import disk

    starts = suggested_throws(open_study(study, store), n, throws)
    for line in as_lines(starts):
        to_stdout(line)
    if out is not None:
        with disk.explained("writing throws", out, advice="choose another file"):
            out.write_text(as_csv(starts), encoding="utf-8")
        to_stdout(f"starts in {out}")
