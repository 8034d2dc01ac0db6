"""puddle verify: check every byte of a store."""

from typing import Annotated

import typer

from pipeline.commands.exit_codes import INCOMPLETE, interruptible
from pipeline.commands.options import StudyOptions, with_options


@with_options
def verify(
    options: StudyOptions,
    discard: Annotated[
        bool, typer.Option("--discard", help="Remove damaged items; the next run computes them again.")
    ] = False,
) -> None:
    """Hash everything in a store again; name what is damaged and how to repair it."""
    from pipeline.commands.damage import verify_lines
    from pipeline.workflow.progress import progress

    store = options.open_store(create=False)
    with interruptible(), store.lock_all() if discard else store.lock_to_read(), progress() as show:
        lines, intact = verify_lines(store, discard=discard, progress=show, how_to_run=options.command)
    typer.echo("\n".join(lines))
    if not intact:
        raise typer.Exit(INCOMPLETE)
