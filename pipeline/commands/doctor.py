"""puddle doctor: check a machine before a long study."""

from dataclasses import asdict

import typer

from pipeline.commands.exit_codes import INCOMPLETE, interruptible
from pipeline.commands.options import AsJson, StudyOptions, Workers, print_json, with_options
from pipeline.commands.output import to_stdout


@with_options
def doctor(options: StudyOptions, workers: Workers = None, as_json: AsJson = False) -> None:
    """Check this machine before a long study: versions, disk, memory, permissions, processor, Ray."""
    from pipeline.commands.examination import examine

    checks = []
    with interruptible():
        for check in examine(options.settings(), options.store, n_workers=workers):
            checks.append(check)
            if not as_json:
                to_stdout(f"{check.verdict:<5} {check.what}: {check.found}")
                if check.advice:
                    to_stdout(f"      {check.advice}")
    failed = any(check.verdict == "fail" for check in checks)
    if as_json:
        print_json({"ok": not failed, "checks": [asdict(check) for check in checks]})
    if failed:
        raise typer.Exit(INCOMPLETE)
