"""The graph of a study: its stages and chains under one set of settings, and how far each chain has got.

What the store holds is done, and nothing else is: a chain's progress is counted from its first item as far as the store
has its items. pipeline/workflow/dispatcher.py computes what is missing.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pipeline.config.settings import RecordedSettings, Settings
from pipeline.errors import DamagedArtifact, OtherVersion, PuddleError
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store, StudyRecord
from pipeline.workflow.code_digest import is_of_other_code
from pipeline.workflow.identity import OutputId
from pipeline.workflow.record import settings_of
from pipeline.workflow.stage import AnyStage, Chain, Failure, Item, MissingInputs, Results, Upstream


@dataclass(eq=False)
class ChainProgress:
    """How far a chain has got."""

    chain: Chain[Any]
    manifests: list[Manifest] = field(default_factory=list)
    n_failures: int = 0  # consecutive failures of the next item, computed by itself
    failed: Failure | None = None  # why the chain can't go on, if it can't
    elsewhere: bool = False  # whether today's code would give its items other keys than those on record
    alone: bool = False  # whether the next item has failed: it is tried again by itself, so that no other fails with it

    @property
    def finished(self) -> bool:
        """Whether every item is done."""
        return len(self.manifests) == self.chain.n_items

    @property
    def open(self) -> bool:
        """Whether there is an item to compute."""
        return not self.finished and self.failed is None

    def batches_with(self, other: ChainProgress) -> bool:
        """Return whether the next items of both chains may be computed in one batch."""
        return (
            not (self.alone or other.alone)
            and (self.chain.batch_key, self.chain.units) == (other.chain.batch_key, other.chain.units)
            and len(self.manifests) == len(other.manifests)
        )

    @property
    def left(self) -> float:
        """Cost of the work still to do."""
        return self.chain.weight * sum(self.chain.units[len(self.manifests) :])

    @property
    def done(self) -> float:
        """Cost of the work done."""
        return self.chain.weight * sum(self.chain.units[: len(self.manifests)])


@dataclass(frozen=True)
class StageRun:
    """A stage under one study's settings, and where its results are."""

    stage: AnyStage
    settings: Settings
    upstream: Upstream
    store: Store
    say: Callable[[str], None]  # shows a line to the user, such as that an item is damaged

    def chains(self, recorded: Mapping[tuple[str, str], Sequence[str]] = MappingProxyType({})) -> list[ChainProgress]:
        """Plan the stage's chains, and say how far the store has each.

        Args:
            recorded: keys of items by stage and label of their chain; they count whatever today's code makes of them.
        """
        planned = list(self.stage.plan(self.settings))
        known = {chain.label for chain in planned}
        gone = [label for stage, label in recorded if stage == self.stage.name and label not in known]
        if planned and isinstance(planned[0].identity, OutputId):  # whose label says all, also of one without code here
            planned += [Chain(OutputId(label), (1,), None) for label in gone]
        progress = []
        for chain in planned:
            keys = recorded.get((self.stage.name, chain.label))
            progress.append(self._planned(chain) if keys is None else self._recorded(chain, keys))
        return progress

    def _planned(self, chain: Chain[Any]) -> ChainProgress:
        progress = ChainProgress(chain)
        try:
            self.advance(progress)
        except MissingInputs as missing:
            progress.failed = Failure(str(missing), tried=False)
        return progress

    def _recorded(self, chain: Chain[Any], keys: Sequence[str]) -> ChainProgress:
        units = chain.units if len(chain.units) == len(keys) else chain.units[:1] * len(keys)
        progress = ChainProgress(replace(chain, units=units))
        for index, key in enumerate(keys):
            has_code = chain.spec is not None and not isinstance(self.settings, RecordedSettings)
            if has_code and len(progress.manifests) == index:
                with contextlib.suppress(MissingInputs):
                    progress.elsewhere |= self.next_item(progress).key != key
            try:
                manifest = self.store.manifest(self.stage.name, key)
                progress.manifests += [] if manifest is None else [manifest]
            except (DamagedArtifact, OtherVersion) as error:
                self.say(f"{error}")
        return progress

    def next_item(self, progress: ChainProgress) -> Item[Any]:
        """Specify a chain's next item; raise MissingInputs if an input failed or is not done."""
        previous = progress.manifests[-1] if progress.manifests else None
        return self.stage.item(self.settings, progress.chain, len(progress.manifests), previous, self.upstream)

    def advance(self, progress: ChainProgress) -> None:
        """Advance a chain as far as the store has its items. A damaged item counts as missing."""
        while not progress.finished:
            try:
                manifest = self.store.manifest(self.stage.name, self.next_item(progress).key)
            except DamagedArtifact as damage:
                self.say(f"{damage}")
                return
            if manifest is None:
                return
            progress.manifests.append(manifest)


def results_of(stage: AnyStage, chains: Sequence[ChainProgress]) -> Results:
    """Return how far a stage has got."""
    by_id = {progress.chain.identity: progress for progress in chains}
    return Results(
        stage=stage.name,
        done={identity: tuple(progress.manifests) for identity, progress in by_id.items() if progress.finished},
        failed={identity: progress.failed for identity, progress in by_id.items() if progress.failed is not None},
        unfinished=tuple(identity for identity, progress in by_id.items() if progress.open),
        n_done={identity: len(progress.manifests) for identity, progress in by_id.items()},
        seconds=sum(float(m.record.get("seconds", 0.0)) for progress in chains for m in progress.manifests),
        n_other_code=sum(is_of_other_code(m, stage) for progress in chains for m in progress.manifests),
    )


def other_code(upstream: Upstream) -> str:
    """Name the stages that a different version of the code made, in one line; empty if there are none."""
    stages = [name for name, results in upstream.items() if results.n_other_code]
    if not stages:
        return ""
    return (
        f"A different version of the code made items of {', '.join(stages)}. If the change affects results, run again "
        f"with --recompute {stages[0]}, or raise the stage's version."
    )


@dataclass(frozen=True)
class Survey:
    """What the store holds of a study, by stage."""

    chains: Mapping[str, Sequence[ChainProgress]]
    upstream: Upstream
    elsewhere: tuple[str, ...]  # stages that today's code and settings would give other keys than the record
    missing: tuple[str, ...]  # names of what the record has settings or results of, and no code is here

    @property
    def items(self) -> set[tuple[str, str]]:
        """Stage and key of every item."""
        return {(stage, one.key) for stage, chains in self.chains.items() for each in chains for one in each.manifests}

    def note(self, name: str) -> str:
        """Say in a line what code is missing, that today's leads elsewhere, or that other code made results; or ""."""
        said = f"study {name}: shown as it was recorded. "
        if self.missing:
            said += f"The code of {', '.join(self.missing)} is not here. "
        if self.elsewhere:
            said += f"Today's code leads its settings to other results of {', '.join(self.elsewhere)}; "
            said += f"`puddle study {name}` computes them."
        return said.rstrip() if self.missing or self.elsewhere else other_code(self.upstream)


def survey(
    settings: Settings,
    stages: Sequence[AnyStage],
    store: Store,
    *,
    record: StudyRecord | None = None,
    say: Callable[[str], None] = lambda line: None,
) -> Survey:
    """Return what the store holds of a study's first stages.

    Recorded items count by their keys, if the record is of these settings; others where the settings lead.
    """
    keys: dict[tuple[str, str], list[str]] = {}
    missing: list[str] = []
    if record is not None and settings_of(record) == settings:
        missing += RecordedSettings.model_validate(record.settings).missing
        for item in record.items:  # in the order of their chains
            keys.setdefault((item.stage, item.label.rpartition("#")[0]), []).append(item.key)
    read = {name for stage in stages for name in stage.reads(settings)}  # not the page, which names its versions
    chains: dict[str, list[ChainProgress]] = {}
    upstream: dict[str, Results] = {}
    for stage in stages:
        run = StageRun(stage, settings, upstream, store, say)
        chains[stage.name] = run.chains(keys)
        upstream[stage.name] = results_of(stage, chains[stage.name])
    led = (name for name, own in chains.items() if name in read and any(one.elsewhere for one in own))
    gone = (made for own in chains.values() for one in own if one.chain.spec is None for made in one.manifests)
    missing += [Path(file).stem for made in gone for file in made.files]
    return Survey(chains, upstream, tuple(led), tuple(dict.fromkeys(missing)))


def discard_items(settings: Settings, names: Collection[str], stages: Sequence[AnyStage], store: Store) -> int:
    """Discard what the store holds of stages with some names, so that it is computed again; return how many items.

    The caller has locked the store against drivers of studies.
    """
    items = survey(settings, stages, store).items
    with contextlib.suppress(PuddleError):
        record = store.read_study(settings.name)
        if record is not None and settings_of(record) == settings:  # behind something missing, too
            items |= {(item.stage, item.key) for item in record.items}
    discarded = sorted(item for item in items if item[0] in names)
    for item in discarded:
        store.discard(*item)
    return len(discarded)


def require(settings: Settings, stage: AnyStage, stages: Sequence[AnyStage], upstream: Mapping[str, Results]) -> None:
    """Raise PuddleError if a stage lacks any result upstream; it names the first stage to run, and what it lacks."""
    needed = set(stage.reads(settings))
    for earlier in reversed(stages):
        if earlier.name in needed:
            needed.update(earlier.reads(settings))
    for name in (earlier.name for earlier in stages if earlier.name in needed):
        if missing := upstream[name].unfinished:
            raise PuddleError(
                f"{stage.name} needs the results of {name}, and {len(missing)} of them are missing "
                f"(the first: {missing[0].label}).\n"
                f"Run `puddle {name}` with the same options first, or `puddle study` for everything."
            )
