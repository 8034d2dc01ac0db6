"""puddle gc: items that no study of a store needs, and those whose commit was interrupted.

A study needs the items that its record lists and those that its settings lead to: one that was stopped halfway has no
record of its last stage yet. Nothing is removed while a study is driven, or where what a study needs can't be told,
because its record is unreadable, or because an item that it lists is gone and others are made from it.
"""

from collections.abc import Iterator
from typing import Annotated

import typer

from pipeline.commands.options import DEFAULT_STORE, StorePath, to_copy, with_options
from pipeline.commands.terminal import to_stdout
from pipeline.config.settings import RecordedSettings
from pipeline.errors import PuddleError
from pipeline.stages import STAGES
from pipeline.store.store import Store
from pipeline.workflow.graph import survey
from pipeline.workflow.record import settings_of


@with_options
def gc(
    store: StorePath = DEFAULT_STORE,
    remove: Annotated[bool, typer.Option("--remove", help="Remove the garbage; without it, only list it.")] = False,
) -> None:
    """List what no study of a store needs, or remove it."""
    opened = Store.open(store, create=False)
    with opened.lock_all():
        garbage = find_garbage(opened)
        sizes = {item: opened.item_bytes(*item) for item in garbage}
        for item in garbage if remove else ():
            opened.discard(*item)
    names, freed = opened.studies(), f"{sum(sizes.values()) / 1e6:,.1f} MB"
    to_stdout(f"{opened.root}: {len(names)} studies{': ' if names else ''}{', '.join(names)}")
    for stage in sorted({stage for stage, _ in garbage}):
        of_stage = [n_bytes for item, n_bytes in sizes.items() if item[0] == stage]
        to_stdout(f"  {stage}: {len(of_stage):,} items that no study needs, {sum(of_stage) / 1e6:,.1f} MB")
    if not garbage:
        to_stdout("Everything in it is needed.")
    elif remove:
        to_stdout(f"Removed: {freed} are free again.")
    else:
        to_stdout(f"Nothing is removed yet. `{to_copy('gc --remove', store)}` removes it and frees {freed}.")


def find_garbage(store: Store) -> list[tuple[str, str]]:
    """Return stage and key of every item that no study needs, or raise a PuddleError if it can't be determined.

    The caller holds the whole store.
    """
    needed: set[tuple[str, str]] = set()
    for name in store.studies():
        try:
            needed.update(_needs(store, name))
        except PuddleError as error:
            raise PuddleError(
                f"{error}\nSo puddle can't determine what study {name} needs, and nothing is removed. Run the study "
                f"again, or delete {store.study_path(name)} to forget it; then collect garbage."
            ) from error
    return [item for item in (*store.items(), *store.items(committed=False)) if item not in needed]


def _needs(store: Store, name: str) -> Iterator[tuple[str, str]]:
    """Yield stage and key of every item that a study needs."""
    record = store.read_study(name)
    if record is None:
        raise PuddleError(f"{store.record_path(name)}: expected a study's record, found no file.")
    for item in record.items:
        if store.manifest(item.stage, item.key) is None:
            path = store.manifest_path(item.stage, item.key)
            raise PuddleError(f"{path}: expected study {name}'s {item.stage} {item.label}, found no file.")
        yield item.stage, item.key
    damage, settings = list[str](), settings_of(record)
    if isinstance(settings, RecordedSettings):
        raise PuddleError(f"study {name}: expected the code of {', '.join(settings.missing)}, found none.")
    yield from survey(settings, STAGES, store, say=damage.append).items
    if damage:
        raise PuddleError(damage[0])
