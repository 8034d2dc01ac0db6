"""puddle status: what of a study is done, running, failed and missing."""

from dataclasses import asdict
from typing import Annotated

import typer

from pipeline.commands.options import AsJson, StudyOptions, print_json, with_options
from pipeline.commands.output import to_stdout
from pipeline.errors import PuddleError


@with_options
def status(
    options: StudyOptions,
    digests: Annotated[bool, typer.Option("--digests", help="Print the SHA-256 of everything that is done.")] = False,
    as_json: AsJson = False,
) -> None:
    """Print what of a study is done, running, failed and missing.

    Where the store has a study of that name, its recorded settings count, and differences from those given are named.
    """
    from pipeline.commands.study_status import digest_lines, shown_settings, status_lines, study_status

    if digests and as_json:
        raise PuddleError("expected --digests or --json, got both")
    store = options.open_store(create=False)
    settings, differences, record = shown_settings(options.settings(), store)
    with store.lock_to_read():
        if digests:
            for line in digest_lines(settings, store):
                to_stdout(line)
            return
        found = study_status(settings, store, record, with_diverged=True)
    if as_json:
        print_json({**asdict(found), "done": found.is_done, "settings_differ": differences})
        return
    for line in status_lines(found, store_bytes=store.size_bytes()):
        to_stdout(line)
    if differences:
        to_stdout("That is the study on record. The settings given differ from it (recorded → given):")
        for line in differences:
            to_stdout(f"  {line}")
        to_stdout(f"`{options.command('forecast')}` shows what they would need.")
    elif record is None and (names := store.studies()):
        to_stdout(f"The store has no study {settings.name}, but {', '.join(names)}: `puddle status --study NAME`.")
