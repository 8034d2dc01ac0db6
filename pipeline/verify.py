"""Verify: hash a whole store again, name what is damaged, and say what will be computed again."""

from __future__ import annotations

from collections.abc import Callable

from pipeline.artifacts import digest
from pipeline.disk import inside, read
from pipeline.errors import DamagedArtifact, PuddleError
from pipeline.progress import Progress
from pipeline.store import Store


def verify_lines(store: Store, *, progress: Progress, how_to_run: Callable[[str], str]) -> tuple[list[str], bool]:
    """Hash everything that a store holds.

    Args:
        store: to verify.
        progress: the terminal.
        how_to_run: gives the command line that runs a stage or the study, for messages.

    Returns:
        Lines for the user: one for each thing that is wrong, what is needed to mend it; and whether all is well.
    """
    n_bytes = store.size_bytes()
    with progress.stage("verify", unit="MB", total=n_bytes / 1e6) as bar:
        wrong = store.verify(checked=lambda n_checked: bar.advance(n_checked / 1e6))
    if not any(isinstance(error, PuddleError) and not isinstance(error, DamagedArtifact) for error in wrong):
        wrong += _other_reports(store)
    lines = [f"{error}" for error in wrong]
    n_items = sum(1 for stage in store.stages() for _ in store.keys(stage))
    if not wrong:
        lines.append(f"{store.root}: {n_items:,} items, {n_bytes / 1e6:,.1f} MB: every byte is as it was committed.")
        return lines, True
    damaged = {
        (error.stage, error.key) for error in wrong if isinstance(error, DamagedArtifact) and error.stage and error.key
    }
    lines.append(f"{store.root}: {len(wrong)} things are not as they were committed; it holds {n_items:,} items.")
    if damaged:
        lines.append(
            f"Running a study again computes the {len(damaged)} damaged items that it needs, and nothing else: "
            f"`{how_to_run('study')}`. They are in:"
        )
        lines += [f"  {where}" for where in _where(store, damaged)]
    return lines, False


def _other_reports(store: Store) -> list[PuddleError]:
    """Compare the reports that people look at with those that the store holds."""
    wrong: list[PuddleError] = []
    for name in store.studies():
        try:
            record = store.read_study(name)
            pages = [item for item in record.items if item.stage == "report"] if record else []
            manifests = [store.manifest(page.stage, page.key) for page in pages]
        except DamagedArtifact:  # said already
            continue
        for manifest in manifests:
            for file, entry in manifest.files.items() if manifest else ():
                path = inside(store.export_path(name), file)
                if path.is_file() and digest(read(path, at_most=entry.n_bytes)) != entry.sha256:
                    wrong.append(
                        DamagedArtifact(
                            f"{path}: expected SHA-256 {entry.sha256}, came another file. It is a copy of what the "
                            f"store holds: running study {name} again puts it back."
                        )
                    )
    return wrong


def _where(store: Store, damaged: set[tuple[str, str]]) -> list[str]:
    """Say in which studies the damaged items are."""
    lines, found = [], set()
    for name in store.studies():
        try:
            record = store.read_study(name)
        except DamagedArtifact:
            continue
        for item in record.items if record else ():
            if (item.stage, item.key) in damaged:
                found.add((item.stage, item.key))
                lines.append(f"study {name}: {item.stage} {item.label}")
    lines += [f"no study: {stage} {key}; `puddle gc` removes it" for stage, key in sorted(damaged - found)]
    return lines
