"""puddle doctor: check a machine before a long study."""

import typer

from pipeline.commands.exit_codes import INCOMPLETE, interruptible
from pipeline.commands.options import StudyOptions, Workers, with_options


@with_options
def doctor(options: StudyOptions, workers: Workers = None) -> None:
    """Check this machine before a long study: versions, disk, memory, permissions, processor, Ray."""
    from pipeline.commands.examination import examine

    failed = False
    with interruptible():
        for check in examine(options.settings(), options.store, n_workers=workers):
            failed = failed or check.verdict == "fail"
            typer.echo(f"{check.verdict:<5} {check.what}: {check.found}")
            if check.advice:
                typer.echo(f"      {check.advice}")
    if failed:
        raise typer.Exit(INCOMPLETE)
