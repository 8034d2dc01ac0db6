"""The `puddle` command line: its commands, and how an error becomes a message and an exit code.

The modules of commands import what is slow only when a command runs: `puddle --help` answers at once, and threads are
pinned before numpy, numba or torch is loaded.
"""

import importlib.metadata
import sys
from collections.abc import Callable
from typing import Annotated, Any

import typer

from pipeline.cluster import prepare_process
from pipeline.commands import build, care, designs, studies, study
from pipeline.commands.servo import servo
from pipeline.commands.terminal import Commands, exit_with, flush, to_stdout, write_what_can_be_encoded
from pipeline.errors import PuddleError

app = typer.Typer(
    cls=Commands,
    help="Evolve robots for a world whose physics the simulator lacks.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)

_PANELS: dict[str, dict[str, Callable[..., None]]] = {
    "Daily": {
        "study": study.stage_command(),
        "status": studies.status,
        "studies": studies.studies,
        "champions": studies.champions,
        "compare": studies.compare,
        "export": studies.export,
        "simulate": designs.simulate,
        "score": designs.score,
        "ui": studies.ui,
        "settings": studies.settings,
    },
    "Build": {"fabricate": build.fabricate, "track": build.track, "compare-run": build.compare_run},
    "Care": {"doctor": care.doctor, "verify": care.verify, "gc": care.gc, "forecast": care.forecast},
    "Stages": {name: study.stage_command(name) for name in study.STAGE_SUMMARIES},
}
_SUMMARIES = {"study": "Run every stage that is not done yet; show the results.", **study.STAGE_SUMMARIES}

for _panel, _commands in _PANELS.items():
    for _name, _command in _commands.items():
        app.command(_name, help=_SUMMARIES.get(_name), rich_help_panel=_panel)(_command)
app.add_typer(servo, name="servo", rich_help_panel="Build")


def _show_version(wanted: bool) -> None:
    if wanted:
        to_stdout(f"puddle {importlib.metadata.version('puddle')}")
        raise typer.Exit()


@app.callback()
def _puddle(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Evolve robots for a world whose physics the simulator lacks."""


def main(arguments: list[str] | None = None, run: Callable[[list[str] | None], Any] = app) -> Any:
    """Run the command line, and exit.

    A user's mistake ends in one message and exit code 2; a bug in puddle in a traceback and exit code 70.
    """
    prepare_process()
    write_what_can_be_encoded()
    try:
        if sys.flags.optimize > 1:
            raise PuddleError("PYTHONOPTIMIZE=2 and python -OO drop the docstrings that Ray and MLflow need: unset it.")
        try:
            return run(arguments)
        finally:
            flush()
    except Exception as error:
        exit_with(error)
