"""puddle study, and one command per stage: run what is not done yet."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import ExecutionOptions, StudyOptions, to_copy, with_options
from pipeline.commands.terminal import INCOMPLETE, to_stderr, to_stdout
from pipeline.commands.time_model import forecast_stages
from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.mlflow.mirror import Tracker
from pipeline.report.render import as_text
from pipeline.report.study_page import scale_words
from pipeline.stages import STAGES, environments
from pipeline.stages.collect import COLLECT
from pipeline.stages.reader import read_study
from pipeline.stages.report import PAGE
from pipeline.stages.tracked import check_tracks
from pipeline.stages.train import TRAIN
from pipeline.store.store import Store
from pipeline.workflow.driver import drive
from pipeline.workflow.graph import ChainProgress, discard_items, require, results_of, survey
from pipeline.workflow.progress import progress
from pipeline.workflow.stage import AnyStage, Upstream
from tasks.analysis.columns import scored_by
from tasks.analysis.tables.transfer import TOO_WIDE, TransferRow, transfer_rows
from tasks.discovery import FAILURES
from tasks.evolution import require_search

Recompute = Annotated[
    list[str] | None,
    typer.Option(
        "--recompute",
        metavar="STAGE",
        help="Discard this stage's results and make them anew, and what depends on them if they change.",
    ),
]


@with_options
def study(options: StudyOptions, execution: ExecutionOptions, recompute: Recompute = None) -> None:
    """Run every stage that is not done yet; show the results."""
    _run_stages(options, execution, (), recompute or ())


def stage_command(stage: str) -> Callable[..., None]:
    """Return the command that runs one stage."""

    @with_options
    def command(options: StudyOptions, execution: ExecutionOptions, recompute: Recompute = None) -> None:
        _run_stages(options, execution, (stage,), recompute or ())

    return command


def _run_stages(
    options: StudyOptions, execution: ExecutionOptions, stages: tuple[str, ...], recompute: Collection[str]
) -> None:
    """Run stages, and name what failed or diverged; if anything did, exit with INCOMPLETE."""
    settings = options.settings()
    wanted = [stage for stage in STAGES if not stages or stage.name in stages]
    names = [stage.name for stage in wanted]
    if unknown := [name for name in recompute if name not in names]:
        raise PuddleError(f"--recompute {unknown[0]}: expected a stage that this command runs: {', '.join(names)}")
    try:
        require_search(settings.evolution.search)
    except ValueError as error:
        raise PuddleError(f"evolution.{error}") from None
    for failure in FAILURES:
        to_stderr(f"left out: {failure}")
    environments.check_media(settings)
    _check_inputs(options, settings, wanted[0])
    if TRAIN in wanted and execution.address is None:
        _check_device(settings, options.find_store())
    store = options.open_store(create=True)
    if recompute:
        _discard(settings, recompute, store)
    with progress() as show:
        upstream = drive(
            settings,
            wanted,
            stages=STAGES,
            store=store,
            open_cluster=execution.cluster,
            tracker=Tracker(store.root, execution.tracking_uri, say=show.say),
            progress=show,
            source=options.source,
            expected_seconds=lambda n: {one.stage: one.seconds(n) for one in forecast_stages(settings, store)},
        )
    if wanted[-1] is STAGES[-1]:
        _show_headline(settings, upstream, store, options.store)
    results = upstream.items()
    failed = [f"{name}: {one.label}: {why}" for name, of in results for one, why in of.failed.items()]
    diverged = [f"{name}: {one.label}: {what}" for name, of in results for one, what in of.diverged.items()]
    if failed:
        to_stderr("\n".join([f"{len(failed)} chains of work failed; the rest is done:", *failed]))
    if diverged:
        to_stderr(
            "\n".join(["Designs diverged; the rest is done:", *diverged])
            + "\nRollouts in a sound world stay finite: check the settings of physics and media, and the networks' "
            "errors on the page.\nThe same settings give the same result again; finished work is safe."
        )
    if failed or diverged:
        raise typer.Exit(INCOMPLETE)


def _show_headline(settings: Settings, upstream: Upstream, store: Store, folder: Path) -> None:
    """Print the champions' displacement at the greatest depth, the page's address, and the commands to try next."""
    depth, objective = max(settings.grid.depths), settings.evolution.maximised
    trials = read_study(settings, upstream, store).trials
    rows = [row for row in transfer_rows(trials, settings.target) if row.depth == depth]
    to_stdout(
        objective.with_unit(
            f"\nChampions of study {settings.name} in {settings.target_label}, {depth:g} m deep: mean ± SD over trials"
        ),
        f"selected for: {settings.selected_for}",
        *filter(None, [scale_words(settings)]),
        *as_text(scored_by(objective, TransferRow), rows, TOO_WIDE, learners=settings.arm_learners),
    )
    page = store.export_path(settings.name) / PAGE
    if page.is_file():
        to_stdout(f"Open: {page.as_uri()}")
    commands = {
        to_copy(f"champions {settings.name}", folder): "rank the champions",
        to_copy(f"export {settings.name} --out {settings.name}", folder): "take the results out",
        to_copy(f"ui {settings.name}", folder): "browse runs and curves in MLflow",
    }
    width = max(map(len, commands))
    to_stdout("Next:", *(f"  {command:<{width}}  {what}" for command, what in commands.items()))


def _discard(settings: Settings, names: Collection[str], store: Store) -> None:
    with store.lock_all():
        n_items = discard_items(settings, names, STAGES, store)
    to_stderr(
        f"{n_items:,} items of {', '.join(names)} are discarded and will be made anew. If this run stops, continue "
        f"without --recompute."
    )


def _check_device(settings: Settings, store: Store | None) -> None:
    """Refuse networks that are to be trained on a GPU that is not here, before the throws are made."""
    if all(learner.training.device == "cpu" for learner in settings.ensembles.values()):
        return
    until = STAGES[: 1 + STAGES.index(TRAIN)]
    if store is not None and not survey(settings, until, store).upstream[TRAIN.name].unfinished:
        return
    from tasks.residual.torch_descent import no_device  # imports torch

    if why := no_device():
        advice = "Networks of a core are others: training.device=cpu"
        raise PuddleError(f"training.device is cuda, and there is no CUDA device: {why}. {advice}")


def _check_inputs(options: StudyOptions, settings: Settings, first: AnyStage) -> None:
    """Refuse a stage whose inputs are missing or bad before anything is written: no store, no record."""
    until = STAGES[: STAGES.index(first)] or [COLLECT]
    if (store := options.find_store()) is None:
        plans = [(stage, [ChainProgress(chain) for chain in stage.plan(settings)]) for stage in until]
        upstream: Upstream = {stage.name: results_of(stage, chains) for stage, chains in plans}
    else:
        upstream = survey(settings, until, store).upstream  # the driver names damage
    require(settings, first, STAGES, upstream)
    if first is COLLECT and upstream["collect"].unfinished:
        check_tracks(settings)
