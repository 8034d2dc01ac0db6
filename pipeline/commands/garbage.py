"""Garbage: items that no study of a store needs, and what killed drivers left in /tmp.

A study needs the items that its record lists and the items that its settings lead to; a study that was stopped halfway
has no record of its last stage yet. Where an item in the middle is gone (it was discarded as damaged), the settings
lead no further. But that item will be computed again, to the same bytes, so the study also needs the items behind the
gap. A gap is a digest that no item has. If two items have the same bytes, the loss of one leaves no gap: what an
unfinished study needs behind it is removed, and computed again. Nothing is removed while a study is driven, or where
it can't be determined what a study needs.
"""

import contextlib
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.cluster import session
from pipeline.errors import PuddleError
from pipeline.stages import STAGES
from pipeline.store import disk
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.graph import ChainProgress, StageRun, results_of
from pipeline.workflow.identity import to_json
from pipeline.workflow.record import settings_of
from pipeline.workflow.stage import AnyStage, Results


@dataclass(frozen=True)
class Garbage:
    """What can be removed from a store and from /tmp."""

    items: tuple[tuple[str, str], ...]  # (stage, key) that no study needs, each before the items that it was made from
    uncommitted: tuple[tuple[str, str], ...]  # (stage, key) whose commit never finished
    temporary: tuple[Path, ...]  # temporary files of studies, left by a process that died
    sessions: tuple[Path, ...]  # ray's folders in /tmp whose driver is dead


def find_garbage(store: Store) -> Garbage:
    """Find what no study needs, or raise a PuddleError if it can't be determined. The caller holds the whole store."""
    committed = list(_readable(store))
    behind_gaps = _behind_gaps(committed)
    needed: set[tuple[str, str]] = set()
    for name in (*store.studies(), *store.studies(recorded=False)):
        try:
            needed.update(_needs(store, name, behind_gaps))
        except PuddleError as error:
            raise PuddleError(
                f"{error}\nSo puddle can't determine what study {name} needs, and nothing is removed. Run the study "
                f"again, or delete {store.study_path(name)} to forget it; then collect garbage."
            ) from error
    stages = store.stages()
    unneeded = [(stage, key) for stage in stages for key in store.keys(stage) if (stage, key) not in needed]
    users_first = _users_first([one for one in committed if (one.stage, one.key) not in needed])
    return Garbage(
        items=tuple(dict.fromkeys([*((one.stage, one.key) for one in users_first), *unneeded])),
        uncommitted=tuple((stage, key) for stage in stages for key in store.keys(stage, committed=False)),
        temporary=tuple(store.temporary()),
        sessions=tuple(session.abandoned_sessions()),
    )


def _readable(store: Store) -> Iterator[Manifest]:
    """Yield every manifest that is neither damaged nor a newer puddle's."""
    for stage in store.stages():
        for key in store.keys(stage):
            with contextlib.suppress(PuddleError):
                if manifest := store.listing(stage, key):
                    yield manifest


def _made_from(manifest: Manifest) -> list[str]:
    """Return the digests of an item's inputs; a sealed manifest may still be a stranger's and hold anything."""
    inputs = manifest.identity.get("inputs")
    return sorted({one for one in inputs.values() if isinstance(one, str)}) if isinstance(inputs, dict) else []


def _behind_gaps(committed: Sequence[Manifest]) -> list[Manifest]:
    """Return the items that were made, directly or indirectly, from an item that is gone."""
    users: dict[str, list[Manifest]] = defaultdict(list)
    for one in committed:
        for digest in _made_from(one):
            users[digest].append(one)
    gone = list(users.keys() - {one.digest for one in committed})
    behind: dict[tuple[str, str], Manifest] = {}
    while gone:
        for user in users.get(gone.pop(), ()):
            if (user.stage, user.key) not in behind:
                behind[user.stage, user.key] = user
                gone.append(user.digest)
    return list(behind.values())


def _users_first(garbage: Sequence[Manifest]) -> list[Manifest]:
    """Order items so that each comes before those that it was made from.

    Removal in this order never creates a gap: if this process dies, the next one finds the rest of the garbage.
    """
    n_users = Counter(digest for one in garbage for digest in _made_from(one))
    of_digest: dict[str, list[Manifest]] = defaultdict(list)
    for one in garbage:
        of_digest[one.digest].append(one)
    ordered = [one for one in garbage if not n_users[one.digest]]
    for one in ordered:  # the loop appends to it
        for digest in _made_from(one):
            n_users[digest] -= 1
            if not n_users[digest]:
                ordered += of_digest[digest]
    return ordered


def _in_reach(stage: AnyStage, chains: Sequence[ChainProgress], behind_gaps: Sequence[Manifest]) -> list[Manifest]:
    """Return the items behind gaps that belong to a stage's unfinished chains.

    Their keys can't be computed while their inputs are gone, but an item's specification contains its chain's.
    """
    unfinished = [to_json(progress.chain.spec) for progress in chains if not progress.finished]
    found = []
    for one in behind_gaps:
        spec = one.identity.get("spec")
        if (one.stage, one.identity.get("version")) == (stage.name, stage.version) and isinstance(spec, dict):
            found += [one] if any(of_chain in (spec, *spec.values()) for of_chain in unfinished) else []
    return found


def _needs(store: Store, name: str, behind_gaps: Sequence[Manifest]) -> Iterator[tuple[str, str]]:
    """Yield stage and key of every item that a study needs."""
    record = store.read_study(name)
    if record is None:
        raise PuddleError(f"{store.study_path(name) / 'study.json'}: expected a study's record, found no file.")
    damage: list[str] = []
    settings = settings_of(record)
    upstream: dict[str, Results] = {}
    for stage in STAGES:
        chains = StageRun(stage, settings, upstream, store, damage.append).chains()
        upstream[stage.name] = results_of(stage, chains)
        found = [manifest for progress in chains for manifest in progress.manifests]
        yield from ((stage.name, one.key) for one in (*found, *_in_reach(stage, chains, behind_gaps)))
    if damage:
        raise PuddleError(damage[0])
    yield from ((item.stage, item.key) for item in record.items)


def remove_garbage(store: Store, garbage: Garbage) -> None:
    """Remove garbage. The caller has held the store alone since it was found."""
    for path in garbage.temporary:  # first: they are recognised by the reports in the store
        with disk.explained("removing", path):
            disk.unlink(path)
    for stage, key in (*garbage.items, *garbage.uncommitted):
        store.discard(stage, key)
    session.sweep()


def garbage_lines(store: Store, garbage: Garbage, *, removed: bool, command: str) -> Iterator[str]:
    """List garbage and its size. Call this before the garbage is removed.

    Args:
        store: the store that holds it.
        garbage: what was found.
        removed: whether it will be removed now.
        command: the command line that removes it.
    """
    found: list[tuple[str, int]] = []
    for what, items in (("that no study needs", garbage.items), ("whose commit never ended", garbage.uncommitted)):
        for stage in sorted({stage for stage, _ in items}):
            sizes = [store.item_bytes(stage, key) for one, key in items if one == stage]
            found.append((f"{stage}: {len(sizes):,} items {what}", sum(sizes)))
    found += [(f"{path}: temporary file of a process that died", path.lstat().st_size) for path in garbage.temporary]
    found += [(f"{folder}: left by a driver that is dead", disk.size_bytes(folder)) for folder in garbage.sessions]
    names, total = store.studies(), sum(n_bytes for _, n_bytes in found)
    yield f"{store.root}: {len(names)} studies{': ' if names else ''}{', '.join(names)}"
    yield from (f"  {what}, {n_bytes / 1e6:,.1f} MB" for what, n_bytes in found)
    if not found:
        yield "Everything in it is needed."
    elif removed:
        yield f"Removed: {total / 1e6:,.1f} MB are free again."
    else:
        yield f"Nothing is removed yet. `{command}` removes it and frees {total / 1e6:,.1f} MB."
