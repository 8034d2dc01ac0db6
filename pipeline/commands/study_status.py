"""How far a study has got: by what its settings lead to, and by what its record lists.

The settings lead to an item only as far as all items before it are there. Where one of those is damaged, was discarded
or comes from another version of puddle, the record still lists what was made from it. That work counts as done: if the
lost item is computed again to the same bytes, as it should be, everything behind it is used again.
"""

from __future__ import annotations

import contextlib
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from pipeline.config.settings import Settings
from pipeline.errors import DamagedArtifact, PuddleError
from pipeline.stages import STAGES
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store, StudyRecord
from pipeline.workflow.graph import other_code, survey
from pipeline.workflow.identity import ChainId, item_label
from pipeline.workflow.record import differences, settings_of
from pipeline.workflow.stage import AnyStage, Chain, Results


@dataclass(frozen=True)
class StageStatus:
    """How far a stage has got."""

    stage: str
    state: str  # "done", "running", "started", "missing" or "not needed"
    n_done: int  # items
    n_items: int
    units_done: float
    units: float
    unit: str  # unit of work, in the plural
    core_seconds: float
    failed: Mapping[str, str] = field(default_factory=dict)  # why, by chain
    diverged: Mapping[str, str] = field(default_factory=dict)  # what, by chain
    n_other_code: int = 0  # items that a different version of the code made

    @property
    def line(self) -> str:
        """The stage on the terminal."""
        work = f", {self.units_done:,.0f} of {self.units:,.0f} {self.unit}" if self.units >= 1 else ""
        items = f"{self.n_done:>6} of {self.n_items} items"
        return f"  {self.stage:<9} {self.state:<10} {items}{work}, {self.core_seconds:.0f} core-seconds"


@dataclass(frozen=True)
class StudyStatus:
    """How far a study has got."""

    study: str
    store: str
    driver: str | None  # the process that drives it
    stages: tuple[StageStatus, ...]
    notes: tuple[str, ...] = ()

    @property
    def is_done(self) -> bool:
        """Whether nothing is left to do or to try again."""
        return self.open_stage is None and not any(stage.failed for stage in self.stages)

    @property
    def open_stage(self) -> StageStatus | None:
        """The first stage that is not done."""
        return next((stage for stage in self.stages if stage.state not in ("done", "not needed")), None)

    @property
    def short(self) -> str:
        """The progress in a few words."""
        if stage := self.open_stage:
            number = self.stages.index(stage) + 1
            running = "running, " if self.driver else ""
            items = f"{stage.n_done:,} of {stage.n_items:,} items"
            return f"{running}stage {number} of {len(self.stages)}: {stage.stage}, {items}"
        return "done" if self.is_done else "done, except for what failed"


def shown_settings(given: Settings, store: Store) -> tuple[Settings, list[str], StudyRecord | None]:
    """Return the settings to show for a name: those on record if there are any.

    Args:
        given: the settings that the user named.
        store: holds the record.

    Returns:
        The settings; what differs in those given, as lines; and the record, if any.

    Raises:
        PuddleError: the record is damaged, or another version of puddle wrote it.
    """
    record = store.read_study(given.name)
    if record is None:
        return given, [], None
    return settings_of(record), differences(record.settings, given.model_dump(mode="json")), record


def study_status(settings: Settings, store: Store, record: StudyRecord | None, *, with_diverged: bool) -> StudyStatus:
    """Return how far a study has got.

    Args:
        settings: the study's settings.
        store: the store, which the caller has locked.
        record: the study's record, if it has one.
        with_diverged: whether to look for designs that diverged, which reads the curves of every trial.
    """
    notes: list[str] = []
    upstream = survey(settings, STAGES, store, say=notes.append)
    driver = store.driver_of(settings.name)
    recorded, failed = _recorded(record), _failed(record)
    stages: list[StageStatus] = []
    n_unreached, any_open = 0, False  # a driver runs the stages in order: the first open one is the one that runs
    for stage in STAGES:
        chains, found = stage.plan(settings), upstream[stage.name]
        beyond = {one.identity: _unreached(store, stage.name, one, found, recorded) for one in chains}
        done = {identity: {*range(found.n_done.get(identity, 0)), *manifests} for identity, manifests in beyond.items()}
        n_done, n_items = sum(map(len, done.values())), sum(chain.n_items for chain in chains)
        unreached = [manifest for manifests in beyond.values() for manifest in manifests.values()]
        n_unreached += len(unreached)
        finished = {chain.label for chain in chains if len(done[chain.identity]) == chain.n_items}
        if n_done == n_items:
            state = "done" if chains else "not needed"
        elif driver and not any_open:
            state = "running"
        else:
            state = "started" if n_done else "missing"
        any_open = any_open or state not in ("done", "not needed")
        stages.append(
            StageStatus(
                stage.name,
                state,
                n_done,
                n_items,
                sum(chain.units[index] for chain in chains for index in done[chain.identity]),
                sum(sum(chain.units) for chain in chains),
                stage.unit,
                found.seconds + sum(float(manifest.record.get("seconds", 0.0)) for manifest in unreached),
                failed={label: why for label, why in failed[stage.name].items() if label not in finished},
                diverged=_diverged(stage, settings, found, store, notes.append) if with_diverged else {},
                n_other_code=found.n_other_code,
            )
        )
    notes += filter(None, [other_code(upstream)])
    if n_unreached:
        notes.append(
            f"{n_unreached:,} item{'s are' if n_unreached > 1 else ' is'} on record, made from something that is "
            f"missing, damaged or of another version of puddle. The next `puddle study` computes that again, and uses "
            f"what is then the same."
        )
    return StudyStatus(settings.name, str(store.root), driver, tuple(stages), tuple(notes))


def _recorded(record: StudyRecord | None) -> Mapping[tuple[str, str], str]:
    """Return the keys of the items on record, by stage and label."""
    return {(item.stage, item.label): item.key for item in record.items} if record else {}


def _failed(record: StudyRecord | None) -> Mapping[str, Mapping[str, str]]:
    """Return the reasons of the chains that failed in the study's last run, by stage and label."""
    failed: dict[str, dict[str, str]] = defaultdict(dict)
    for one in record.failed if record else ():
        failed[one.stage][one.label] = one.why
    return failed


def _unreached(
    store: Store, stage: str, chain: Chain[Any], found: Results, recorded: Mapping[tuple[str, str], str]
) -> dict[int, Manifest]:
    """Return the further items of a chain that the record lists and the store has, by their index in the chain."""
    manifests: dict[int, Manifest] = {}
    for index in range(found.n_done.get(chain.identity, 0), chain.n_items):
        if (key := recorded.get((stage, item_label(chain, index)))) is not None:
            with contextlib.suppress(PuddleError):  # damaged: not done
                if manifest := store.manifest(stage, key):
                    manifests[index] = manifest
    return manifests


def _diverged(
    stage: AnyStage, settings: Settings, found: Results, store: Store, say: Callable[[str], None]
) -> Mapping[str, str]:
    diverged: Mapping[ChainId, str] = {}
    try:
        diverged = stage.diverged(settings, found, store)
    except DamagedArtifact as damage:
        say(f"{damage}")
    return {identity.label: what for identity, what in diverged.items()}


def status_lines(status: StudyStatus, *, store_bytes: int) -> Iterator[str]:
    """Describe the study and each stage, each failed chain, and each trial whose designs diverged.

    Args:
        status: the study's status.
        store_bytes: size of the store [bytes].
    """
    yield f"study {status.study} in {status.store} ({store_bytes / 1e6:.1f} MB)"
    yield f"driven by {status.driver}" if status.driver else "no process is driving it"
    for stage in status.stages:
        yield stage.line
        yield from (f"    {label}: {why}" for label, why in [*stage.failed.items(), *stage.diverged.items()])
    if any(stage.diverged for stage in status.stages):
        yield "Designs that diverged would diverge again with the same settings; everything else is safe."
    if any(stage.failed for stage in status.stages):
        yield "Failed work items are tried again by the next `puddle study`; everything else is safe."
    yield from status.notes


def digest_lines(settings: Settings, store: Store) -> Iterator[str]:
    """Give the SHA-256 of every item of the study that is done, and of its files, in the order of the study's plan.

    An item's digest covers the list of its files with their digests; the report and MLflow show the same one.
    """
    for results in survey(settings, STAGES, store, say=lambda line: None).values():
        for chain, manifests in results.done.items():
            for index, manifest in enumerate(manifests):
                yield f"{manifest.digest}  {results.stage}/{chain.label}/{index}"
                for name, entry in sorted(manifest.files.items()):
                    yield f"{entry.sha256}  {results.stage}/{chain.label}/{index}/{name}"
