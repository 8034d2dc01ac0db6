"""Commands that show what a store holds: studies, their champions and tables, and the settings behind them."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.commands.options import (
    DEFAULT_STORE,
    AsJson,
    OptionalStudy,
    StorePath,
    StudyArgument,
    StudyOptions,
    TrackingUri,
    output_suffix,
    program,
    with_options,
)
from pipeline.commands.terminal import print_json, to_stderr, to_stdout
from pipeline.errors import PuddleError

if TYPE_CHECKING:
    from pipeline.results.recorded_study import Study

_LINE_LENGTH = 110  # of a comparison


@with_options
def status(options: StudyOptions, as_json: AsJson = False) -> None:
    """Print what of a study is done, running, failed and missing.

    Where the store has a study of that name, its recorded settings count, and differences from those given are named.
    """
    from pipeline.commands.study_status import status_lines, study_status
    from pipeline.workflow.record import differences as differences_of
    from pipeline.workflow.record import settings_of

    store, settings = options.open_store(), options.settings(to_compute=False)
    record = store.read_study(settings.name)
    recorded = settings_of(record) if record else settings
    differences = differences_of(recorded, settings)
    found = study_status(recorded, store, record, with_diverged=True)
    if as_json:
        print_json({**asdict(found), "done": found.is_done, "settings_differ": differences})
        return
    to_stdout(*status_lines(found))
    if differences:
        to_stdout(
            "That is the study on record. The settings given differ from it (recorded → given):",
            *(f"  {line}" for line in differences),
            f"`{options.command('forecast')}` shows what they would need.",
        )
    elif record is None and (names := store.studies()):
        to_stdout(f"The store has no study {settings.name}, but {', '.join(names)}: `{program()} status NAME`.")


@with_options
def studies(store: StorePath = DEFAULT_STORE, as_json: AsJson = False) -> None:
    """List the studies of a store: progress, settings, page."""
    from pipeline.commands.study_status import describe, list_studies
    from pipeline.store.store import Store

    opened = Store.open(store, create=False)
    listed = list(list_studies(opened))
    if as_json:
        print_json({"store": str(opened.root), "studies": [asdict(one) for one in listed]})
        return
    noun = "study" if len(listed) == 1 else "studies"
    to_stdout(f"{len(listed) or 'no'} {noun} in {opened.root}")
    for one in listed:
        to_stdout("", *describe(one))


@with_options
def champions(study: StudyArgument, store: StorePath = DEFAULT_STORE) -> None:
    """Rank a study's champions by their score in the target."""
    from pipeline.report.render import as_text
    from tasks.analysis.registry import scored_by
    from tasks.analysis.scores import ScoredTrial

    opened = _opened(study, store)
    objective = opened.settings.evolution.maximised
    rows = [row for row in opened.trials() if row.status == "ok"]
    if not rows:
        why = f"no trial has been transferred to {opened.settings.target_label} yet, or every design diverged"
        raise PuddleError(f"study {opened.name} has no champions: {why}")
    ranked = sorted(rows, key=lambda row: (-row.depth, isnan(row.zero_shot), -row.zero_shot))
    to_stdout(
        f"study {opened.name}: champions by zero-shot {objective.label.lower()} in {opened.settings.target_label}",
        f"selected for: {opened.settings.selected_for}",
        *as_text(scored_by(objective, ScoredTrial), ranked, without=("status",), learners=opened.settings.arm_learners),
    )
    if n_without := len(opened.settings.grid.trials()) - len(rows):
        to_stdout(f"\n{n_without} of {len(rows) + n_without} trials have no champion yet, or every design diverged.")
    export_them = StudyOptions(study=opened.name, store=store).command("export")
    to_stdout(f"\n`{export_them} --out {opened.name}` writes the design file of each.")


@with_options
def compare(
    a: StudyArgument,
    b: Annotated[str | None, typer.Argument(metavar="[B]", help="The reference, a study.")] = None,
    arms: Annotated[
        tuple[str, str] | None, typer.Option("--arms", help="Two arms of one study, such as designed_throws dry_land.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Write the table, too: .html, .md, .tex, .csv or .json.")
    ] = None,
    store: StorePath = DEFAULT_STORE,
) -> None:
    """Compare two studies, or two arms of one.

    Each arm is compared with the same arm at every depth: the difference A - B, its interval, and a verdict.
    """
    from pipeline.report.render import MARKS, as_text
    from pipeline.results.comparisons import SAID_ABOVE, SUFFIXES, compare_arms, compare_studies, written_comparison
    from pipeline.store import disk
    from tasks.analysis.comparison import Comparison
    from tasks.analysis.registry import scored_by

    if (b is None) == (arms is None):
        raise PuddleError("expected two studies, or one study and --arms A B")
    suffix = "" if out is None else output_suffix(out, SUFFIXES, replaces=False)
    first = _opened(a, store)
    compared = compare_studies(first, _opened(str(b), store)) if arms is None else compare_arms(first, *arms)
    to_stdout(f"A: {compared.a}; B: {compared.b}, the reference")
    to_stdout(*(f"  {name}: {of_a} → {of_b}" for name, of_a, of_b in compared.changes))
    kind = scored_by(compared.objective, Comparison)
    to_stdout(compared.caution, *as_text(kind, compared.rows, SAID_ABOVE, width=_LINE_LENGTH))
    counts = Counter(row.verdict for row in compared.rows)
    listed = ", ".join(f"{counts[verdict]} {verdict}" for verdict in MARKS if counts[verdict])
    to_stdout(
        f"\n{len(compared.rows)} comparisons: {listed}. They agree if the interval lies within what is "
        f"negligible, and differ if it lies outside and p is below 5 %."
    )
    if out is not None:
        disk.write(out, written_comparison(compared, suffix).encode())
        to_stdout(f"\nWritten: {out}")


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
    mjcf: Annotated[bool, typer.Option("--mjcf", help="Write champions as models of MuJoCo (XML), too.")] = False,
    store: StorePath = DEFAULT_STORE,
) -> None:
    """Write champions, tables, figures and LaTeX to a folder.

    The histories, all designs that ever lived, may be gigabytes: --table histories --table adaptations writes them.
    """
    from pipeline.results.export_folder import export_study

    to_stdout(*export_study(_opened(study, store), out, tables=tables, mjcf=mjcf))


@with_options
def ui(
    study: OptionalStudy = None,
    store: StorePath = DEFAULT_STORE,
    tracking_uri: TrackingUri = None,
    port: Annotated[int, typer.Option("--port", min=1, max=65535, help="Port on the loopback interface.")] = 5000,
) -> None:
    """Show a store's studies, or the runs of one, in MLflow."""
    from pipeline.mlflow.server import show_ui
    from pipeline.store.store import Store

    root = store if tracking_uri else Store.open(store, create=False).root
    show_ui(root, port, uri=tracking_uri or None, study=study)


@with_options
def settings(options: StudyOptions) -> None:
    """Print every setting with its unit, reason and value.

    The text is a file to start your own from.
    """
    from pipeline.config.annotated import annotated_lines

    to_stdout(*annotated_lines(options.settings(to_compute=False)))


def _opened(study: str, store: Path) -> Study:
    from pipeline.results.recorded_study import open_study

    return open_study(study, store, say=to_stderr)
