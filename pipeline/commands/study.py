"""puddle study, and one command per stage: run what is not done yet."""

from collections.abc import Callable
from contextlib import AbstractContextManager

import typer

from pipeline.cluster import Cluster
from pipeline.commands.exit_codes import INCOMPLETE, interruptible, to_stderr
from pipeline.commands.options import ExecutionOptions, StudyOptions, with_options

STAGE_SUMMARIES = {
    "collect": "Throw rectangles into slush and record what the base simulator gets wrong.",
    "train": "Train the ensemble of residual networks on the throws.",
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
    def command(context: typer.Context, options: StudyOptions, execution: ExecutionOptions) -> None:
        execution.check(context)
        run_stages(options, stages, open_cluster=execution.cluster(), tracking_uri=execution.tracking_uri)

    return command


def run_stages(
    options: StudyOptions,
    stages: tuple[str, ...] = (),
    *,
    open_cluster: Callable[[], AbstractContextManager[Cluster]],
    tracking_uri: str | None = None,
) -> None:
    """Run stages, and name what failed or diverged; if anything did, exit with INCOMPLETE.

    Args:
        options: the study.
        stages: names of the stages to run; all of them if empty.
        open_cluster: starts or joins the cluster, once there is something to compute.
        tracking_uri: an MLflow server; the store's own database by default.
    """
    from pipeline.stages import STAGES
    from pipeline.tracking.mirror import Tracker
    from pipeline.workflow.driver import drive
    from pipeline.workflow.progress import progress

    settings = options.settings()
    store = options.open_store(create=True)
    with interruptible(), progress() as show:
        upstream = drive(
            settings,
            [stage for stage in STAGES if not stages or stage.name in stages],
            stages=STAGES,
            store=store,
            open_cluster=open_cluster,
            tracker=Tracker(store.root, tracking_uri, say=show.say),
            progress=show,
            how_to_run=options.command,
            source=options.source,
        )
    found = upstream.items()
    failed = [f"{name}: {of.label}: {why}" for name, results in found for of, why in results.failed.items()]
    diverged = [f"{name}: {of.label}: {what}" for name, results in found for of, what in results.diverged.items()]
    if failed:
        to_stderr("\n".join([f"{len(failed)} chains of work failed; the rest is done:", *failed]))
    if diverged:
        to_stderr("\n".join(["Designs diverged; the rest is done:", *diverged, _ADVICE_ON_DIVERGENCE]))
    if failed or diverged:
        raise typer.Exit(INCOMPLETE)
