"""Collect garbage: what no study of a store needs, and what drivers that were killed left in /tmp.

A study needs the items that its record lists, and those that its settings lead to: a study that was stopped half-way
has no record of its last stage yet. While a study is driven nothing is removed, and where it can't be told what a study
needs, nothing is either.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pipeline import disk
from pipeline.cluster import session
from pipeline.driver import settings_of
from pipeline.errors import PuddleError
from pipeline.stage import Results
from pipeline.stages import STAGES
from pipeline.store import Store
from pipeline.study import follow, results_of


@dataclass(frozen=True)
class Garbage:
    """What nothing needs."""

    items: tuple[tuple[str, str], ...]
    """Stage and key of the items that no study needs."""
    halves: tuple[tuple[str, str], ...]
    """Stage and key of the items whose commit never came to its end."""
    temporary: tuple[Path, ...]
    """Files of studies that were on their way to their place when a process died; see :meth:`Store.temporary`."""
    sessions: tuple[Path, ...]
    """Folders of Ray's in /tmp that no driver holds any more."""


def find_garbage(store: Store) -> Garbage:
    """Find what nothing needs. The caller holds the store alone (:meth:`Store.lock_all`).

    Raises:
        PuddleError: where it can't be told what a study needs; says why, and what to do.
    """
    needed: set[tuple[str, str]] = set()
    for name in (*store.studies(), *store.studies(recorded=False)):
        try:
            needed.update(_needs(store, name))
        except PuddleError as error:
            raise PuddleError(
                f"{error}\nSo it can't be told what study {name} needs, and nothing is removed. Run it again, or "
                f"delete {store.study_path(name)} to forget it; then collect garbage."
            ) from error
    stages = store.stages()
    return Garbage(
        items=tuple((stage, key) for stage in stages for key in store.keys(stage) if (stage, key) not in needed),
        halves=tuple((stage, key) for stage in stages for key in store.keys(stage, committed=False)),
        temporary=tuple(store.temporary()),
        sessions=tuple(session.dead()),
    )


def _needs(store: Store, name: str) -> Iterator[tuple[str, str]]:
    """Give stage and key of every item that a study needs."""
    record = store.read_study(name)
    if record is None:
        raise PuddleError(f"{store.study_path(name) / 'study.json'}: expected a study's record, came no file.")
    damage: list[str] = []
    settings = settings_of(record)
    upstream: dict[str, Results] = {}
    for stage in STAGES:
        walks = follow(stage, settings, store, upstream, say=damage.append)
        upstream[stage.name] = results_of(stage, walks)
        yield from ((stage.name, manifest.key) for walk in walks for manifest in walk.manifests)
    if damage:
        raise PuddleError(damage[0])
    yield from ((item.stage, item.key) for item in record.items)


def remove(store: Store, garbage: Garbage) -> None:
    """Remove garbage. The caller has held the store alone since it was found."""
    for path in garbage.temporary:  # first: they are known by the reports that the store holds
        with disk.explained("removing", path):
            disk.unlink(path)
    for stage, key in (*garbage.items, *garbage.halves):
        store.remove(stage, key)
    session.sweep()


def gc_lines(store: Store, garbage: Garbage, *, removed: bool, command: str) -> Iterator[str]:
    """Say what nothing needs. Call it before it is removed: it is weighed.

    Args:
        store: that holds it.
        garbage: what was found.
        removed: whether it will be removed now.
        command: the command line that removes it.
    """
    total = 0
    names = store.studies()
    yield f"{store.root}: {len(names)} studies{': ' if names else ''}{', '.join(names)}"
    for what, items in (("that no study needs", garbage.items), ("whose commit never ended", garbage.halves)):
        for stage in sorted({stage for stage, _ in items}):
            sizes = [store.item_bytes(stage, key) for one, key in items if one == stage]
            total += sum(sizes)
            yield f"  {stage}: {len(sizes):,} items {what}, {sum(sizes) / 1e6:,.1f} MB"
    for path in garbage.temporary:
        total += path.lstat().st_size
        yield f"  {path}: on its way when a process died, {path.lstat().st_size / 1e6:,.1f} MB"
    for folder in garbage.sessions:
        total += disk.size_bytes(folder)
        yield f"  {folder}: left by a driver that is dead, {disk.size_bytes(folder) / 1e6:,.1f} MB"
    if not any((garbage.items, garbage.halves, garbage.temporary, garbage.sessions)):
        yield "Everything in it is needed."
    elif removed:
        yield f"Removed: {total / 1e6:,.1f} MB are free again."
    else:
        yield f"Nothing is removed yet. `{command}` removes it, and frees {total / 1e6:,.1f} MB."
