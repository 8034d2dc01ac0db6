"""What of a study is done, running and missing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from pipeline.config.settings import Settings
from pipeline.errors import DamagedArtifact
from pipeline.stages import STAGES
from pipeline.store.store import Store
from pipeline.workflow.graph import survey
from pipeline.workflow.stage import Results, Stage


def status_lines(settings: Settings, store: Store) -> Iterator[str]:
    """Give lines for the study and each stage, for each piece set aside, and for each trial whose designs diverged.

    Raises:
        PuddleError: where `puddle gc` is at work.
    """
    with store.lock_to_read():
        yield from _status_lines(settings, store)


def _status_lines(settings: Settings, store: Store) -> Iterator[str]:
    notes: list[str] = []
    upstream = survey(settings, STAGES, store, say=notes.append)
    failed = _set_aside(settings, store)
    driver = store.driver_of(settings.name)
    yield f"study {settings.name} in {store.root} ({store.size_bytes() / 1e6:.1f} MB)"
    yield f"driven by {driver}" if driver else "no process is driving it"
    any_diverged = any_open = False  # a driver runs the stages in order: the first that is open is the one that runs
    for stage in STAGES:
        chains = stage.plan(settings)
        total = sum(sum(chain.units) for chain in chains)
        found = upstream[stage.name]
        done = sum(sum(chain.units[: found.n_done.get(chain.label, 0)]) for chain in chains)
        n_done, n_items = sum(found.n_done.values()), sum(chain.n_items for chain in chains)
        if not found.unfinished and not found.failed:
            state = "done" if chains else "not needed"
        elif driver and not any_open:
            state = "running"
        else:
            state = "started" if n_done else "missing"
        any_open = any_open or bool(found.unfinished)
        yield (
            f"  {stage.name:<9} {state:<10} {n_done:>6} of {n_items} pieces, {done:,.0f} of {total:,.0f} {stage.unit}, "
            f"{found.seconds:.0f} core-seconds"
        )
        for label, why in failed.get(stage.name, {}).items():
            if label not in found.done:
                yield f"    {label}: {why}"
        diverged = _diverged(stage, settings, found, store, notes)
        any_diverged = any_diverged or bool(diverged)
        for label, what in diverged.items():
            yield f"    {label}: {what}"
    if any_diverged:
        yield "What diverged does so again under the same settings; all else is safe."
    if any(label not in upstream[name].done for name, lost in failed.items() for label in lost):
        yield "Pieces that were set aside are tried again by the next `puddle study`; all else is safe."
    yield from notes


def _set_aside(settings: Settings, store: Store) -> dict[str, dict[str, str]]:
    """Give what the study's last run gave up, and why, by stage and label; nothing where its settings were others."""
    record = store.read_study(settings.name)
    lost: dict[str, dict[str, str]] = {}
    if record is not None and record.settings == settings.model_dump(mode="json"):
        for one in record.failed:
            lost.setdefault(one.stage, {})[one.label] = one.why
    return lost


def _diverged(stage: Stage, settings: Settings, found: Results, store: Store, notes: list[str]) -> Mapping[str, str]:
    """Say what diverged in a stage, by label; what can't be read is noted."""
    try:
        return stage.diverged(settings, found, store)
    except DamagedArtifact as damage:
        notes.append(str(damage))
        return {}


def digest_lines(settings: Settings, store: Store) -> Iterator[str]:
    """Give the SHA-256 of every item of the study that is done, and of its files, in the order of the study's plan.

    An item's is that of the list of its files with theirs: the digest that the report and MLflow show.

    Raises:
        PuddleError: where `puddle gc` is at work.
    """
    with store.lock_to_read():
        upstream = survey(settings, STAGES, store, say=lambda line: None)
    for results in upstream.values():
        for label, manifests in results.done.items():
            for index, manifest in enumerate(manifests):
                yield f"{manifest.digest}  {results.stage}/{label}/{index}"
                for name, entry in sorted(manifest.files.items()):
                    yield f"{entry.sha256}  {results.stage}/{label}/{index}/{name}"
