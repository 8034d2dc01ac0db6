"""Verify: hash a whole store again, name what is damaged or gone, and say what will be computed again."""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Callable, Iterator, Sequence

from pipeline.errors import DamagedArtifact, PuddleError
from pipeline.store import disk
from pipeline.store.store import WRITTEN_ANEW, Store, StudyItem
from pipeline.workflow.progress import Progress, Work


def find_damage(
    store: Store,
    *,
    checked: Callable[[int], None] = lambda n_bytes: None,
    say: Callable[[str], None] = lambda line: None,
) -> list[PuddleError]:
    """Hash everything that a store holds, and look for what its studies list and it does not hold.

    Args:
        store: to verify.
        checked: is told the length of everything once it has been looked at.
        say: is told what was left out.

    Returns:
        What is wrong, empty where all is well. Damage to an item is a DamagedArtifact with its stage and key.
    """
    wrong = store.verify(checked=checked)
    if not store.links():
        for name in store.studies(recorded=False):
            if store.driver_of(name):  # it has just begun, and is about to write it
                continue
            path = store.study_path(name) / "study.json"
            wrong.append(DamagedArtifact(f"{path}: expected a study's record, came no file. {WRITTEN_ANEW}"))
        for name in store.studies():
            wrong += _lacking(store, name, say)
    return list({str(error): error for error in wrong}.values())  # a manifest that is damaged is met twice


def _lacking(store: Store, name: str, say: Callable[[str], None]) -> Iterator[PuddleError]:
    """Look for a study's items and for the report that people look at, a copy of one that the store holds.

    A driver writes the record first and the report's copy after it.
    """
    if driver := store.driver_of(name):  # asked before the record is read
        say(f"study {name} is driven by {driver}: the copy of its report was left out.")
    for item in _items(store, name):
        try:
            yield from _lacks(store, name, item, with_report=not driver)
        except PuddleError as error:
            yield error


def _lacks(store: Store, name: str, item: StudyItem, *, with_report: bool) -> Iterator[PuddleError]:
    manifest = store.listing(item.stage, item.key)
    if manifest is None:
        yield DamagedArtifact(
            f"{store.manifest_path(item.stage, item.key)}: expected the manifest of study {name}'s {item.stage} "
            f"{item.label}, came no file. {store.computed_again()}",
            stage=item.stage,
            key=item.key,
        )
    elif item.stage == "report" and with_report:
        for file, entry in manifest.files.items():
            path = disk.inside(store.export_path(name), file)
            with disk.explained("reading the report", path):
                came = disk.digest_of(path, at_most=entry.n_bytes) if path.is_file() else "no file"
            if came != entry.sha256:
                yield DamagedArtifact(
                    f"{path}: expected SHA-256 {entry.sha256}, came {came}. It is a copy of what the store holds: "
                    f"running study {name} puts it back."
                )


def _items(store: Store, name: str) -> Sequence[StudyItem]:
    try:
        record = store.read_study(name)
    except PuddleError:  # said already
        return ()
    return record.items if record else ()


def damaged_items(wrong: Sequence[PuddleError]) -> set[tuple[str, str]]:
    """Return stage and key of the items among what is wrong."""
    damage = [error for error in wrong if isinstance(error, DamagedArtifact)]
    return {(error.stage, error.key) for error in damage if error.stage and error.key}


def _unfinished_lines(store: Store, wrong: Sequence[PuddleError]) -> Iterator[str]:
    """Say of how many items there are files and no manifest, besides those that a study lists and lacks."""
    halves = {(stage, key) for stage in store.stages() for key in store.keys(stage, committed=False)}
    n_files = sum(store.item_bytes(*half) > 0 for half in halves - damaged_items(wrong))
    if n_files:
        remove = shlex.join(["puddle", "gc", "--remove", "--store", str(store.root)])
        yield (
            f"{n_files:,} unfinished items: files without a manifest, which is written last. A driver that is at work "
            f"ends its own; what a killed one left, or what lost its manifest, `{remove}` removes."
        )


def verify_lines(
    store: Store, *, discard: bool, progress: Progress, how_to_run: Callable[[str], str]
) -> tuple[list[str], bool]:
    """Verify a store, for a person.

    Args:
        store: to verify.
        discard: whether to forget the damaged items. The caller then holds the store alone.
        progress: the terminal.
        how_to_run: gives the command line that runs a command, for messages.

    Returns:
        Lines: what was left out, what is unfinished and what is wrong, and what mends it; and whether all is well.

    Raises:
        PuddleError: where `puddle gc` is at work.
    """
    with contextlib.nullcontext() if discard else store.lock_to_read():  # an item on its way out would seem damaged
        return _verify_lines(store, discard=discard, progress=progress, how_to_run=how_to_run)


def _verify_lines(
    store: Store, *, discard: bool, progress: Progress, how_to_run: Callable[[str], str]
) -> tuple[list[str], bool]:
    n_bytes = store.bytes_to_verify()
    left_out: list[str] = []

    def megabytes(n: int) -> Work:
        return Work(n / 1e6, cost=n / 1e6)

    with progress.stage("verify", unit="MB", total=megabytes(n_bytes)) as bar:
        wrong = find_damage(store, checked=lambda n_checked: bar.advance(megabytes(n_checked)), say=left_out.append)
    n_items = sum(1 for stage in store.stages() for _ in store.keys(stage))
    left_out += _unfinished_lines(store, wrong)
    if not wrong:
        well = f"{store.root}: {n_items:,} items, {n_bytes / 1e6:,.1f} MB: every byte is as it was committed."
        return [*left_out, well], True
    lines = [*left_out, *(str(error) for error in wrong)]
    lines.append(f"{store.root}: {len(wrong)} things are wrong; {n_items:,} items were looked at.")
    if damaged := damaged_items(wrong):
        used = [
            (f"  study {name}: {item.stage} {item.label}", (item.stage, item.key))
            for name in store.studies()
            for item in _items(store, name)
            if (item.stage, item.key) in damaged
        ]
        lines += ["To be computed again, and nothing else:", *(line for line, _ in used)]
        lines += [f"  of no study: {stage} {key}" for stage, key in sorted(damaged - {item for _, item in used})]
        if discard:
            for stage, key in damaged:
                store.discard(stage, key)
            lines.append(f"They are discarded: `{how_to_run('study')}` computes them again.")
        else:
            lines.append(f"`{how_to_run('verify')} --discard` forgets them; `{how_to_run('study')}` makes them again.")
    return lines, False
