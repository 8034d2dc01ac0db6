"""puddle verify: check every byte of a store."""

from dataclasses import asdict
from typing import Annotated

import typer

from pipeline.commands.exit_codes import INCOMPLETE, interruptible
from pipeline.commands.options import AsJson, StudyOptions, print_json, with_options
from pipeline.commands.output import to_stdout


@with_options
def verify(
    options: StudyOptions,
    discard: Annotated[
        bool, typer.Option("--discard", help="Remove damaged items; the next run computes them again.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Hash everything in a store again, or one --study; name what is damaged and how to repair it."""
    from pipeline.commands import damage
    from pipeline.workflow.progress import progress

    if options.study is not None:
        options.settings()  # refuses a name that is unknown, and a record that is damaged
    store = options.open_store(create=False)
    with interruptible(), store.lock_all() if discard else store.lock_to_read(), progress() as show:
        found = damage.verify(store, options.study, discard=discard, progress=show)
    if as_json:
        print_json({**asdict(found), "intact": found.intact})
    else:
        to_stdout("\n".join(damage.verification_lines(found, how_to_run=options.command)))
    if not found.intact:
        raise typer.Exit(INCOMPLETE)
