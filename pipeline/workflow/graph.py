"""A study: the graph of stages under one set of settings, and how far each of its chains has got.

What the store holds is done, and nothing else is: a chain is walked from its start as far as the store knows its
pieces. pipeline/workflow/dispatcher.py does what is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from pipeline.config.settings import Settings
from pipeline.errors import DamagedArtifact, PuddleError
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.progress import Work
from pipeline.workflow.stage import NOT_POSSIBLE, Chain, Item, MissingInputs, Results, Stage, Upstream


@dataclass
class Walk:
    """How far a chain has got."""

    chain: Chain
    manifests: list[Manifest] = field(default_factory=list)
    n_failed: int = 0
    """Failures in a row of the piece that is next."""
    failed: str | None = None
    """Why the chain can't go on, if it can't."""
    alone: bool = False
    """Whether the piece that is next has failed: it is tried again without company, to take nobody along."""
    slowest: float = 0.0
    """Seconds a weighted unit, of the pieces that were found kept and tell what one takes now."""

    @property
    def finished(self) -> bool:
        """Whether every piece is done."""
        return len(self.manifests) == self.chain.n_items

    @property
    def open(self) -> bool:
        """Whether there is a piece to do."""
        return not self.finished and self.failed is None

    def goes_with(self, other: Walk) -> bool:
        """Tell whether the pieces that are next may be computed side by side."""
        return (
            not (self.alone or other.alone)
            and (self.chain.world, self.chain.units) == (other.chain.world, other.chain.units)
            and len(self.manifests) == len(other.manifests)
        )

    @property
    def next_work(self) -> float:
        """Weighted units of the piece that is next."""
        return self.chain.weight * self.chain.units[len(self.manifests)]

    @property
    def left(self) -> Work:
        """What is still to do."""
        return self._work(self.chain.units[len(self.manifests) :])

    @property
    def done(self) -> Work:
        """What is done."""
        return self._work(self.chain.units[: len(self.manifests)])

    def _work(self, units: Sequence[float]) -> Work:
        return Work(sum(units), self.chain.weight * sum(units))


def next_item(stage: Stage, settings: Settings, walk: Walk, upstream: Upstream) -> Item:
    """Specify the piece that is next."""
    previous = walk.manifests[-1] if walk.manifests else None
    return stage.item(settings, walk.chain, len(walk.manifests), previous, upstream)


def follow(
    stage: Stage, settings: Settings, store: Store, upstream: Upstream, *, say: Callable[[str], None]
) -> list[Walk]:
    """Walk every chain of a stage as far as the store holds it.

    A damaged item counts as missing, and ``say`` says so; its successor will take its place.
    """
    walks = []
    for chain in _evenly_weighted(stage.plan(settings)):
        walk = Walk(chain)
        try:
            go_on(stage, settings, walk, store, upstream, say)
        except MissingInputs as missing:
            walk.failed = f"{NOT_POSSIBLE}{missing}"
        walks.append(walk)
    return walks


def go_on(
    stage: Stage, settings: Settings, walk: Walk, store: Store, upstream: Upstream, say: Callable[[str], None]
) -> None:
    """Walk a chain from where it is as far as the store holds it."""
    while not walk.finished:
        item = next_item(stage, settings, walk, upstream)
        manifest = _held(store, item, say)
        if manifest is None:
            return
        # Another engine may be a hundred times as fast, and batches share what cores there were: no measure of now.
        if manifest.record.get("execution") == item.execution and not is_batched(item):
            seconds = float(manifest.record.get("seconds", 0.0)) * walk.chain.batch_size  # a share, perhaps
            walk.slowest = max(walk.slowest, seconds / walk.next_work)
        walk.manifests.append(manifest)


def _evenly_weighted(chains: Sequence[Chain]) -> list[Chain]:
    """Scale weights so that they average to one, and weighted units add up to the units that there are."""
    units = [sum(chain.units) for chain in chains]
    weighted = sum(u * chain.weight for u, chain in zip(units, chains, strict=True))
    scale = sum(units) / weighted if weighted > 0 else 1.0
    return [replace(chain, weight=chain.weight * scale) for chain in chains]


def _held(store: Store, item: Item, say: Callable[[str], None]) -> Manifest | None:
    try:
        return store.manifest(item.stage, item.key)
    except DamagedArtifact as damage:
        say(f"{damage}")
        return None


def results_of(stage: Stage, walks: Sequence[Walk]) -> Results:
    """Sum up how far a stage has got."""
    return Results(
        stage=stage.name,
        done={walk.chain.label: tuple(walk.manifests) for walk in walks if walk.finished},
        failed={walk.chain.label: walk.failed for walk in walks if walk.failed is not None},
        unfinished=tuple(walk.chain.label for walk in walks if walk.open),
        n_done={walk.chain.label: len(walk.manifests) for walk in walks},
        seconds=sum(float(m.record.get("seconds", 0.0)) for walk in walks for m in walk.manifests),
    )


def survey(
    settings: Settings, stages: Sequence[Stage], store: Store, *, say: Callable[[str], None]
) -> dict[str, Results]:
    """Find what the store holds of each stage, in order; nothing is computed."""
    upstream: dict[str, Results] = {}
    for stage in stages:
        upstream[stage.name] = results_of(stage, follow(stage, settings, store, upstream, say=say))
    return upstream


def require(
    settings: Settings, stage: Stage, stages: Sequence[Stage], upstream: Upstream, *, how_to_run: Callable[[str], str]
) -> None:
    """Refuse to start a stage whose inputs are not there, or theirs.

    Where an input's input is missing, the input itself can't be asked for: it counts as not possible, not as missing.

    Args:
        settings: the study's.
        stage: what is to start.
        stages: all of the study, in their order.
        upstream: results of the stages before it.
        how_to_run: gives the command line that runs a stage.

    Raises:
        PuddleError: names the first stage that must come first, what it lacks, and the command that runs it.
    """
    needed = set(stage.reads(settings))
    for earlier in reversed(stages):
        if earlier.name in needed:
            needed.update(earlier.reads(settings))
    for name in (earlier.name for earlier in stages if earlier.name in needed):
        lacking = upstream[name].unfinished
        if lacking:
            raise PuddleError(
                f"{stage.name} needs the results of {name}, and {len(lacking)} of them are missing "
                f"(the first: {lacking[0]}).\n"
                f"Run `{how_to_run(name)}` first, or `{how_to_run('study')}` for everything."
            )


def is_batched(item: Item) -> bool:
    """Tell whether a piece only hands batches to other workers: it needs no core of its own."""
    return item.execution.get("designs_per_batch") is not None
