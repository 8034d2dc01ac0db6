"""The `puddle` command line: its commands, and how an error becomes a message and an exit code.

A command is a function of the module of its name, which is imported when the command runs: `puddle --help` answers at
once, threads are pinned before numpy, numba or torch is loaded, and settings have fields for what --with registers.
"""

import ast
import importlib.metadata
import sys
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from pipeline.cluster.process import prepare_process
from pipeline.commands.servo import servo
from pipeline.commands.terminal import Commands, exit_with, flush, to_stdout, write_what_can_be_encoded
from pipeline.errors import PuddleError
from pipeline.extensions import add

STAGE_SUMMARIES = {
    "collect": "Throw rectangles into the target: what the simulator gets wrong.",
    "train": "Train the ensemble of residual networks on the throws.",
    "evolve": "Evolve designs in every environment, at every depth.",
    "adapt": "Evolve new controllers for champions in the target.",
    "transfer": "Score champions in the target, zero-shot and adapted.",
    "assess": "Compare the networks' predictions with true displacements.",
    "analyse": "Compute statistics, and where the networks hallucinate.",
    "report": "Write the page that shows the results.",
}

PANELS: dict[str, Sequence[str]] = {
    "Daily": ("study", "status", "studies", "champions", "compare", "export", "simulate", "score", "ui", "settings"),
    "Build": ("fabricate", "track", "compare-run"),
    "Care": ("doctor", "verify", "gc", "forecast"),
    "Stages": tuple(STAGE_SUMMARIES),
}

_OPTIONS: dict[str, Any] = {
    "pretty_exceptions_enable": False,
    "rich_markup_mode": "markdown",
    "context_settings": {"help_option_names": ["-h", "--help"]},
}


def command(name: str) -> TyperCommand:
    """Import a command."""
    if name in STAGE_SUMMARIES:
        function = import_module("pipeline.commands.study").stage_command(name)
    else:
        module = name.replace("-", "_")
        function = getattr(import_module(f"pipeline.commands.{module}"), module)
    alone = typer.Typer(add_completion=False, **_OPTIONS)
    alone.command(name, help=STAGE_SUMMARIES.get(name))(function)
    return typer.main.get_command(alone)  # type: ignore[return-value]


class _NotImported(TyperCommand):
    """A command that the list of commands shows."""

    def make_context(self, *arguments: Any, **options: Any) -> Any:
        """Import the command, and parse its arguments."""
        return command(str(self.name)).make_context(*arguments, **options)


def _summary(name: str) -> str:
    """Return the first line of a command's help: that of its function's docstring."""
    if name in STAGE_SUMMARIES:
        return STAGE_SUMMARIES[name]
    module = name.replace("-", "_")
    source = ast.parse(Path(__file__).with_name(f"{module}.py").read_text(encoding="utf-8"))
    (function,) = (node for node in source.body if isinstance(node, ast.FunctionDef) and node.name == module)
    return (ast.get_docstring(function) or "").partition("\n")[0]


app = typer.Typer(
    cls=Commands, help="Evolve robots for a world whose physics the simulator lacks.", no_args_is_help=True, **_OPTIONS
)
for _panel, _names in PANELS.items():
    for _name in _names:
        app.command(_name, cls=_NotImported, help=_summary(_name), rich_help_panel=_panel)(lambda: None)
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
            add(_extensions(sys.argv[1:] if arguments is None else arguments))
            return run(arguments)
        finally:
            flush()
    except Exception as error:
        exit_with(error)


def _extensions(arguments: Sequence[str]) -> Iterator[Path]:
    """Yield the files of --with."""
    for word, following in pairwise([*arguments, ""]):
        if word == "--with":
            yield Path(following)
        elif word.startswith("--with="):
            yield Path(word.removeprefix("--with="))
