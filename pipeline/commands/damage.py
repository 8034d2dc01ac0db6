"""Damage: hash a whole store again, name what is damaged or missing and what will be computed again."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from pipeline.errors import DamagedArtifact, PuddleError
from pipeline.store import disk
from pipeline.store.store import WRITTEN_ANEW, Store, StudyItem
from pipeline.workflow.progress import Progress, Work


def find_damage(
    store: Store, study: str | None = None, *, checked: Callable[[int], None] = lambda n_bytes: None
) -> list[PuddleError]:
    """Return what is wrong in a store; damage to an item, or its loss, is a DamagedArtifact with its stage and key.

    Args:
        store: the store to verify.
        study: name of the only study to verify; None for the whole store.
        checked: called with the number of bytes checked, file by file.
    """
    wrong = store.verify(study, checked=checked)
    for name in store.studies(recorded=False) if study is None else ():
        if not store.driver_of(name):  # else it has just started, and is about to write the record
            path = store.study_path(name) / "study.json"
            wrong.append(DamagedArtifact(f"{path}: expected a study's record, found no file. {WRITTEN_ANEW}"))
    for name in store.studies() if study is None else (study,):
        driven = store.driver_of(name)  # before the record is read: a driver writes the record, then the report
        for item in _items(store, name):
            try:
                wrong += _check_item(store, name, item, with_report=not driven)
            except PuddleError as error:
                wrong.append(error)
    return list({str(error): error for error in wrong}.values())  # a damaged manifest is found twice


def _check_item(store: Store, name: str, item: StudyItem, *, with_report: bool) -> Iterator[PuddleError]:
    """Check that a study's item exists, and that the exported report equals the item in the store."""
    manifest = store.listing(item.stage, item.key)
    if manifest is None:
        path = store.manifest_path(item.stage, item.key)
        lost = f"{path}: expected the manifest of study {name}'s {item.stage} {item.label}, found no file"
        yield DamagedArtifact(f"{lost}. {store.computed_again()}", stage=item.stage, key=item.key)
    elif item.stage == "report" and with_report:
        for file, entry in manifest.files.items():
            path = store.export_path(name) / file
            with disk.explained("reading the report", path):
                found = disk.digest_of(path) if path.is_file() else "no file"
            if found != entry.sha256:
                advice = f"It is a copy of a file in the store: running study {name} restores it."
                yield DamagedArtifact(f"{path}: expected SHA-256 {entry.sha256}, found {found}. {advice}")


def _items(store: Store, name: str) -> Sequence[StudyItem]:
    try:
        record = store.read_study(name)
    except PuddleError:  # Store.verify reports it
        return ()
    return record.items if record else ()


@dataclass(frozen=True)
class Verification:
    """The result of hashing a store, or one of its studies, again."""

    store: str
    study: str | None  # the only study that was verified
    n_items: int
    n_bytes: int
    problems: tuple[str, ...]
    damaged: tuple[str, ...]  # what has to be computed again, each a study's item
    discarded: bool  # whether the damaged items were removed

    @property
    def intact(self) -> bool:
        """Whether every byte is as it was committed."""
        return not self.problems


def verify(store: Store, study: str | None, *, discard: bool, progress: Progress) -> Verification:
    """Hash a store, or a study of it, again.

    Args:
        store: the store, which the caller has locked: an item being removed would look damaged.
        study: name of the only study to verify; None for the whole store.
        discard: whether to remove the damaged items. The caller then holds the store alone.
        progress: the progress display.
    """
    n_bytes = store.bytes_to_verify(study)

    def megabytes(n: int) -> Work:
        return Work(n / 1e6, cost=n / 1e6)

    with progress.stage("verify", unit="MB", total=megabytes(n_bytes)) as bar:
        wrong = find_damage(store, study, checked=lambda n_checked: bar.advance(megabytes(n_checked)))
    if study is None:
        n_items = sum(1 for stage in store.stages() for _ in store.keys(stage))
    else:
        n_items = len(_items(store, study))
    damaged = {(one.stage, one.key) for one in wrong if isinstance(one, DamagedArtifact) and one.stage and one.key}
    used = [
        (f"study {name}: {item.stage} {item.label}", (item.stage, item.key))
        for name in (store.studies() if damaged else ())
        for item in _items(store, name)
        if (item.stage, item.key) in damaged
    ]
    of_none = [f"of no study: {stage} {key}" for stage, key in sorted(damaged - {item for _, item in used})]
    for stage, key in damaged if discard else ():
        store.discard(stage, key)
    lines = (*(line for line, _ in used), *of_none)
    problems = tuple(map(str, wrong))
    return Verification(str(store.root), study, n_items, n_bytes, problems, lines, discard and bool(damaged))


def verification_lines(found: Verification, *, how_to_run: Callable[[str], str]) -> Iterator[str]:
    """Describe what is wrong, and how to repair it; ``how_to_run`` returns the command line that runs a command."""
    where = found.store if found.study is None else f"study {found.study} in {found.store}"
    if found.intact:
        yield f"{where}: {found.n_items:,} items, {found.n_bytes / 1e6:,.1f} MB: every byte is as it was committed."
        return
    yield from found.problems
    yield f"{where}: {len(found.problems)} problems in {found.n_items:,} items."
    if found.damaged:
        yield "Only these have to be computed again:"
        yield from (f"  {line}" for line in found.damaged)
        if found.discarded:
            yield f"They are discarded: `{how_to_run('study')}` computes them again."
        else:
            yield f"`{how_to_run('verify')} --discard` removes them; then `{how_to_run('study')}` does it."
