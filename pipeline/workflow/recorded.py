"""What a study has on record: its results by their recorded keys, whatever today's code makes of its settings."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

from pipeline.config.settings import Settings
from pipeline.errors import DamagedArtifact, OtherVersion
from pipeline.store.store import Store, StudyRecord
from pipeline.workflow.graph import ChainProgress, StageRun, results_of
from pipeline.workflow.record import settings_of
from pipeline.workflow.stage import AnyStage, MissingInputs, Results, Upstream


@dataclass(frozen=True)
class RecordedResults:
    """The results of a study, and the stages that today's code and settings would give other keys."""

    upstream: Upstream
    elsewhere: tuple[str, ...]

    def note(self, name: str) -> str:
        """Say in a line that today's code leads elsewhere; "" if it does not."""
        if not self.elsewhere:
            return ""
        return (
            f"study {name}: shown as it was recorded. Today's code leads its settings to other results of "
            f"{', '.join(self.elsewhere)}; `puddle study {name}` computes them."
        )


def recorded_results(
    settings: Settings,
    record: StudyRecord | None,
    stages: Sequence[AnyStage],
    store: Store,
    *,
    say: Callable[[str], None] = lambda line: None,
) -> RecordedResults:
    """Return what the store holds of a study: recorded items by their keys, and others where its settings lead.

    Args:
        settings: the study's settings.
        record: the record of its name; it counts if it is of these settings.
        stages: its first stages, in order.
        store: where results are committed.
        say: shows a line to the user, such as that an item is damaged.
    """
    keys: dict[tuple[str, str], list[str]] = {}
    if record is not None and settings_of(record) == settings:
        for item in record.items:  # in the order of their chains
            keys.setdefault((item.stage, item.label.rpartition("#")[0]), []).append(item.key)
    read = {name for stage in stages for name in stage.reads(settings)}  # not the page, which names its versions
    upstream: dict[str, Results] = {}
    elsewhere: list[str] = []
    for stage in stages:
        run, chains, same = StageRun(stage, settings, upstream, store, say), [], True
        for chain in stage.plan(settings):
            listed = keys.get((stage.name, chain.label))
            if listed is None:
                chains.append(run.progress_of(chain))
                continue
            units = chain.units if len(chain.units) == len(listed) else chain.units[:1] * len(listed)
            progress = ChainProgress(replace(chain, units=units))
            for index, key in enumerate(listed):
                if stage.name in read and len(progress.manifests) == index:
                    with suppress(MissingInputs):
                        same &= run.next_item(progress).key == key
                try:
                    manifest = store.manifest(stage.name, key)
                    progress.manifests += [] if manifest is None else [manifest]
                except (DamagedArtifact, OtherVersion) as error:
                    say(f"{error}")
            chains.append(progress)
        upstream[stage.name] = results_of(stage, chains)
        elsewhere += [] if same else [stage.name]
    return RecordedResults(upstream, tuple(elsewhere))
