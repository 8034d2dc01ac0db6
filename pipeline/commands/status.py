"""puddle status: what of a study is done, running, failed and missing."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.commands.options import StudyOptions, with_options
from pipeline.errors import DamagedArtifact

if TYPE_CHECKING:
    from pipeline.config.settings import Settings
    from pipeline.store.store import FailedChain, Store


@with_options
def status(
    options: StudyOptions,
    digests: Annotated[bool, typer.Option("--digests", help="Print the SHA-256 of everything that is done.")] = False,
) -> None:
    """Print what of a study is done, running, failed and missing."""
    lines = digest_lines if digests else status_lines
    settings, store = options.settings(), options.open_store(create=False)
    with store.lock_to_read():
        for line in lines(settings, store):
            typer.echo(line)


def status_lines(settings: Settings, store: Store) -> Iterator[str]:
    """Describe the study and each stage, each failed chain, and each trial whose designs diverged."""
    from pipeline.stages import STAGES
    from pipeline.workflow.graph import survey

    notes: list[str] = []
    upstream = survey(settings, STAGES, store, say=notes.append)
    failed = _failed(settings, store)
    driver = store.driver_of(settings.name)
    yield f"study {settings.name} in {store.root} ({store.size_bytes() / 1e6:.1f} MB)"
    yield f"driven by {driver}" if driver else "no process is driving it"
    any_diverged = any_open = False  # a driver runs the stages in order: the first open one is the one that runs
    for stage in STAGES:
        chains = stage.plan(settings)
        total = sum(sum(chain.units) for chain in chains)
        found = upstream[stage.name]
        done = sum(sum(chain.units[: found.n_done.get(chain.identity, 0)]) for chain in chains)
        n_done, n_items = sum(found.n_done.values()), sum(chain.n_items for chain in chains)
        if not found.unfinished and not found.failed:
            state = "done" if chains else "not needed"
        elif driver and not any_open:
            state = "running"
        else:
            state = "started" if n_done else "missing"
        any_open = any_open or bool(found.unfinished)
        yield (
            f"  {stage.name:<9} {state:<10} {n_done:>6} of {n_items} items, {done:,.0f} of {total:,.0f} {stage.unit}, "
            f"{found.seconds:.0f} core-seconds"
        )
        done_labels = {chain.label for chain in found.done}
        yield from (f"    {one.label}: {one.why}" for one in failed[stage.name] if one.label not in done_labels)
        try:
            diverged = stage.diverged(settings, found, store)
        except DamagedArtifact as damage:
            notes.append(str(damage))
            diverged = {}
        any_diverged = any_diverged or bool(diverged)
        yield from (f"    {identity.label}: {what}" for identity, what in diverged.items())
    if any_diverged:
        yield "Designs that diverged would diverge again with the same settings; everything else is safe."
    if any({one.label for one in of} - {chain.label for chain in upstream[name].done} for name, of in failed.items()):
        yield "Failed work items are tried again by the next `puddle study`; everything else is safe."
    yield from notes


def _failed(settings: Settings, store: Store) -> dict[str, list[FailedChain]]:
    """Return the chains that failed in the study's last run, by stage; none if that had other settings."""
    record = store.read_study(settings.name)
    failed: dict[str, list[FailedChain]] = defaultdict(list)
    for one in record.failed if record and record.settings == settings.model_dump(mode="json") else ():
        failed[one.stage].append(one)
    return failed


def digest_lines(settings: Settings, store: Store) -> Iterator[str]:
    """Give the SHA-256 of every item of the study that is done, and of its files, in the order of the study's plan.

    An item's digest covers the list of its files with their digests; the report and MLflow show the same one.
    """
    from pipeline.stages import STAGES
    from pipeline.workflow.graph import survey

    for results in survey(settings, STAGES, store, say=lambda line: None).values():
        for chain, manifests in results.done.items():
            for index, manifest in enumerate(manifests):
                yield f"{manifest.digest}  {results.stage}/{chain.label}/{index}"
                for name, entry in sorted(manifest.files.items()):
                    yield f"{entry.sha256}  {results.stage}/{chain.label}/{index}/{name}"
