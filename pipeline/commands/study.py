"""puddle study, and one command per stage: run what is not done yet."""

import functools
from collections.abc import Callable, Collection
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.cluster import Cluster
from pipeline.commands.exit_codes import INCOMPLETE, interruptible
from pipeline.commands.options import ExecutionOptions, StudyOptions, with_options
from pipeline.commands.output import to_stderr, to_stdout
from pipeline.errors import PuddleError

if TYPE_CHECKING:
    from pipeline.config.settings import Settings
    from pipeline.store.store import Store
    from pipeline.workflow.dispatcher import Limits
    from pipeline.workflow.stage import AnyStage

STAGE_SUMMARIES = {
    "collect": "Throw rectangles into slush and record what the base simulator gets wrong.",
    "train": "Train the ensemble of residual networks on the throws.",
    "pilot": "Check whether the throws cover what robots do.",
    "evolve": "Evolve designs in every environment, at every depth.",
    "transfer": "Score champions in True Slush, zero-shot and with adapted controllers.",
    "assess": "Compare the networks' predictions of designs with their true displacement.",
    "analyse": "Compute statistics, the comparison with the paper, and where the networks hallucinate.",
    "report": "Write the page that shows the results.",
}

_ADVICE_ON_DIVERGENCE = (
    "Rollouts in a sound world stay finite: check the settings of physics and slush, and the networks' errors on the\n"
    "page. The same settings give the same result again; finished work is safe."
)


def stage_command(*stages: str) -> Callable[..., None]:
    """Return the command that runs some stages, or all of them where none is named."""

    @with_options
    def command(
        options: StudyOptions,
        execution: ExecutionOptions,
        recompute: Annotated[
            list[str] | None,
            typer.Option(
                "--recompute",
                metavar="STAGE",
                autocompletion=lambda: stages or tuple(STAGE_SUMMARIES),
                help="Discard this stage's results and make them anew, and what depends on them if they change.",
            ),
        ] = None,
    ) -> None:
        run_stages(
            options,
            stages,
            open_cluster=execution.cluster(),
            recompute=recompute or (),
            tracking_uri=execution.tracking_uri,
        )

    return command


def run_stages(
    options: StudyOptions,
    stages: tuple[str, ...] = (),
    *,
    open_cluster: Callable[[], AbstractContextManager[Cluster]],
    recompute: Collection[str] = (),
    tracking_uri: str | None = None,
    limits: "Limits | None" = None,
) -> None:
    """Run stages, and name what failed or diverged; if anything did, exit with INCOMPLETE.

    Args:
        options: the study.
        stages: names of the stages to run; all of them if empty.
        open_cluster: starts or joins the cluster, once there is something to compute.
        recompute: names of stages whose results are discarded first.
        tracking_uri: an MLflow server; the store's own database by default.
        limits: how long an item may take, if not as long as usual.

    Raises:
        PuddleError: the stages to recompute are not among those to run.
    """
    from pipeline.commands.headline import headline_lines
    from pipeline.commands.time_model import expected_seconds
    from pipeline.stages import STAGES
    from pipeline.tracking.mirror import Tracker
    from pipeline.workflow.dispatcher import Limits
    from pipeline.workflow.driver import drive
    from pipeline.workflow.progress import progress

    settings = options.settings()
    wanted = [stage for stage in STAGES if not stages or stage.name in stages]
    names = [stage.name for stage in wanted]
    if unknown := [name for name in recompute if name not in names]:
        raise PuddleError(f"--recompute {unknown[0]}: expected a stage that this command runs: {', '.join(names)}")
    _check_inputs(options, settings, wanted[0])
    store = options.open_store(create=True)
    if recompute:
        _discard(settings, recompute, store)
    with interruptible(), progress() as show:
        upstream = drive(
            settings,
            wanted,
            stages=STAGES,
            store=store,
            open_cluster=open_cluster,
            tracker=Tracker(store.root, tracking_uri, say=show.say),
            progress=show,
            how_to_run=options.command,
            source=options.source,
            expected_seconds=functools.partial(expected_seconds, settings, store=store),
            limits=limits or Limits(),
        )
    if wanted[-1] is STAGES[-1]:
        for line in headline_lines(settings, upstream, store, how_to_run=options.named(settings.name).command):
            to_stdout(line)
    found = upstream.items()
    failed = [f"{name}: {identity.label}: {why}" for name, results in found for identity, why in results.failed.items()]
    diverged = [
        f"{name}: {identity.label}: {what}" for name, results in found for identity, what in results.diverged.items()
    ]
    if failed:
        to_stderr("\n".join([f"{len(failed)} chains of work failed; the rest is done:", *failed]))
    if diverged:
        to_stderr("\n".join(["Designs diverged; the rest is done:", *diverged, _ADVICE_ON_DIVERGENCE]))
    if failed or diverged:
        raise typer.Exit(INCOMPLETE)


def _discard(settings: "Settings", names: Collection[str], store: "Store") -> None:
    from pipeline.stages import STAGES
    from pipeline.workflow.graph import discard_items

    with store.lock_all():
        n_items = discard_items(settings, names, STAGES, store)
    to_stderr(
        f"{n_items:,} items of {', '.join(names)} are discarded and will be made anew. If this run stops, continue "
        f"without --recompute."
    )


def _check_inputs(options: StudyOptions, settings: "Settings", first: "AnyStage") -> None:
    """Refuse a stage whose inputs are missing or bad before anything is written: no store, no record."""
    from pipeline.stages import STAGES
    from pipeline.stages.collect import COLLECT
    from pipeline.stages.tracked import check_tracks
    from pipeline.workflow.graph import ChainProgress, require, results_of, survey

    earlier = STAGES[: STAGES.index(first)]
    if (store := options.find_store()) is None:
        plans = [(stage, [ChainProgress(chain) for chain in stage.plan(settings)]) for stage in earlier]
        upstream = {stage.name: results_of(stage, chains) for stage, chains in plans}
    else:
        with store.lock_to_read():
            upstream = survey(settings, earlier, store, say=lambda line: None)  # the driver names damage
    require(settings, first, STAGES, upstream, how_to_run=options.command)
    if first is COLLECT and not _is_done(options, settings, COLLECT):
        check_tracks(settings)


def _is_done(options: StudyOptions, settings: "Settings", stage: "AnyStage") -> bool:
    from pipeline.workflow.graph import survey

    if settings.tracks is None or (store := options.find_store()) is None:
        return False
    with store.lock_to_read():
        found = survey(settings, [stage], store, say=lambda line: None)[stage.name]
    return not found.unfinished
