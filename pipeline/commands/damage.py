"""Damage: hash a store again, name what is damaged or missing and what will be computed again."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from pipeline.errors import DamagedArtifact, PuddleError
from pipeline.store.store import Store, StudyItem
from pipeline.workflow.progress import Progress, Work


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
    n_items = len(list(store.items()) if study is None else _items(store, study))
    n_bytes = 0
    with progress.stage("verify", unit="items", total=Work(n_items, cost=n_items)) as bar:

        def checked(n: int) -> None:
            nonlocal n_bytes
            n_bytes += n
            bar.advance(Work(1, cost=1))

        wrong = store.verify(study, checked=checked)
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
