"""puddle export: the results of a study, for use outside puddle."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from pipeline.commands.exit_codes import interruptible
from pipeline.commands.options import DEFAULT_STORE, StorePath, StudyArgument, with_options
from pipeline.commands.output import to_stderr, to_stdout


@with_options
def export(
    study: StudyArgument,
    out: Annotated[Path, typer.Option("--out", help="A new folder, or an earlier export to replace.")],
    tables: Annotated[
        list[str] | None,
        typer.Option("--table", help="Write only this table; repeat for several. Default: all tables."),
    ] = None,
    kind: Annotated[Literal["parquet", "csv"], typer.Option("--format", help="Format of the tables.")] = "parquet",
    store: StorePath = DEFAULT_STORE,
) -> None:
    """Write a study's champions, tables and figures, and its transfer results in LaTeX, to a folder.

    The histories of a large study, all designs that ever lived, are gigabytes; --table champions leaves them out.
    """
    from pipeline.results.export_folder import export_study
    from pipeline.results.recorded_study import open_study

    with interruptible():
        lines = export_study(open_study(study, store, say=to_stderr), out, kind, tables=tables, say=to_stderr)
    for line in lines:
        to_stdout(line)
