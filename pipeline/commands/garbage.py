"""Garbage: items that no study of a store needs, and what killed drivers left in /tmp.

A study needs the items that its record lists and those that its settings lead to: one that was stopped halfway has no
record of its last stage yet. Nothing is removed while a study is driven, or where what a study needs can't be told,
because its record is unreadable, or because an item that it lists is gone and others are made from it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pipeline.cluster import session
from pipeline.errors import PuddleError
from pipeline.stages import STAGES
from pipeline.store import disk
from pipeline.store.store import Store
from pipeline.workflow.graph import survey
from pipeline.workflow.record import settings_of


@dataclass(frozen=True)
class Garbage:
    """What can be removed from a store and from /tmp."""

    items: tuple[tuple[str, str], ...]  # (stage, key) that no study needs
    uncommitted: tuple[tuple[str, str], ...]  # (stage, key) whose commit never finished
    temporary: tuple[Path, ...]  # temporary files of studies, left by a process that died
    sessions: tuple[Path, ...]  # ray's folders in /tmp whose driver is dead


def find_garbage(store: Store) -> Garbage:
    """Find what no study needs, or raise a PuddleError if it can't be determined. The caller holds the whole store."""
    needed: set[tuple[str, str]] = set()
    for name in (*store.studies(), *store.studies(recorded=False)):
        try:
            needed.update(_needs(store, name))
        except PuddleError as error:
            raise PuddleError(
                f"{error}\nSo puddle can't determine what study {name} needs, and nothing is removed. Run the study "
                f"again, or delete {store.study_path(name)} to forget it; then collect garbage."
            ) from error
    return Garbage(
        items=tuple(item for item in store.items() if item not in needed),
        uncommitted=tuple(store.items(committed=False)),
        temporary=tuple(sorted(path for path in store.root.glob("studies/**/.*.tmp") if path.is_file())),
        sessions=tuple(session.abandoned_sessions()),
    )


def _needs(store: Store, name: str) -> Iterator[tuple[str, str]]:
    """Yield stage and key of every item that a study needs."""
    record = store.read_study(name)
    if record is None:
        raise PuddleError(f"{store.study_path(name) / 'study.json'}: expected a study's record, found no file.")
    for item in record.items:
        if store.manifest(item.stage, item.key) is None:
            path = store.manifest_path(item.stage, item.key)
            raise PuddleError(f"{path}: expected study {name}'s {item.stage} {item.label}, found no file.")
        yield item.stage, item.key
    damage: list[str] = []
    yield from survey(settings_of(record), STAGES, store, say=damage.append).items
    if damage:
        raise PuddleError(damage[0])


def remove_garbage(store: Store, garbage: Garbage) -> None:
    """Remove garbage. The caller has held the store alone since it was found."""
    for path in garbage.temporary:
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
