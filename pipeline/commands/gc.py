"""puddle gc: remove what no study needs."""

from typing import Annotated

import typer

from pipeline.commands.options import DEFAULT_STORE, StorePath, StudyOptions, with_options
from pipeline.commands.output import to_stdout


@with_options
def gc(
    store: StorePath = DEFAULT_STORE,
    remove: Annotated[bool, typer.Option("--remove", help="Remove the garbage; without it, only list it.")] = False,
) -> None:
    """List items that no study of a store needs and leftovers of killed processes, or remove them."""
    from pipeline.commands.garbage import find_garbage, garbage_lines, remove_garbage

    options = StudyOptions(store=store)
    opened = options.open_store(create=False)
    with opened.lock_all():
        found = find_garbage(opened)
        lines = list(garbage_lines(opened, found, removed=remove, command=f"{options.command('gc')} --remove"))
        if remove:
            remove_garbage(opened, found)
    to_stdout("\n".join(lines))
