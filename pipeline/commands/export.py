"""puddle export: the results of a study as files for other programs."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import DEFAULT_STORE, Extensions, StorePath, StudyArgument, with_options
from pipeline.commands.terminal import to_stderr, to_stdout
from pipeline.results.export_folder import export_study
from pipeline.results.recorded_study import open_study


@with_options
def export(
    study: StudyArgument,
    out: Annotated[Path, typer.Option("--out", help="A new folder, or an earlier export to replace.")],
    tables: Annotated[
        list[str] | None,
        typer.Option(
            "--table", help="Write only this table; repeat for several. Default: all but the histories of designs."
        ),
    ] = None,
    mjcf: Annotated[
        bool, typer.Option("--mjcf", help="Write champions as models of MuJoCo (XML), too; oscillators alone.")
    ] = False,
    extensions: Extensions = None,  # noqa: ARG001 (main has imported them)
    store: StorePath = DEFAULT_STORE,
) -> None:
    """Write champions, tables, figures and LaTeX to a folder.

    The histories, all designs that ever lived, may be gigabytes: --table histories --table adaptations writes them.
    """
    to_stdout(*export_study(open_study(study, store, say=to_stderr), out, tables=tables, mjcf=mjcf))
