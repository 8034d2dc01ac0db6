"""The record of a study: settings, items and failed chains, as `puddle status` and `puddle gc` read them."""

import difflib
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from pydantic import ValidationError

from pipeline.config.settings import RecordedSettings, Settings
from pipeline.errors import DamagedArtifact, PuddleError
from pipeline.store.store import WRITTEN_ANEW, FailedChain, Store, StudyItem, StudyRecord
from pipeline.workflow.stage import Upstream
from tasks.discovery import with_failures


class DrivenStudy:
    """The record of the study that this process drives: read once, then rewritten as its stages end."""

    def __init__(self, settings: Settings, store: Store, say: Callable[[str], None], source: str = "") -> None:
        """Put the study's settings on record; ``source`` is "preset laptop", or the path of the file they come from."""
        self._store = store
        self._record = StudyRecord(settings.name, settings.model_dump(mode="json"), (), source=source)
        changes: list[str] = []
        try:
            before = store.read_study(settings.name)
        except DamagedArtifact as damage:
            say(f"{damage}")
            before = None
        try:
            changes = differences(settings_of(before), settings) if before else []
        except PuddleError as other_version:
            say(f"{other_version}")
            before = None
        if before is not None and not changes:
            self._record = replace(before, settings=self._record.settings, source=source or before.source)
        elif before is not None:
            listed = ", ".join(changes[:4]) + (f" and {len(changes) - 4} more" if len(changes) > 4 else "")
            say(
                f"study {settings.name} is on record with different settings ({listed}). This run replaces its report. "
                f"The old results stay in the store until `puddle gc`: a run with the old settings restores the old "
                f"report within seconds. To keep both reports, use --set name=ANOTHER."
            )
        if before != self._record:
            store.write_study(self._record)

    def update(self, upstream: Upstream) -> None:
        """Record what the stages so far made and lack; later stages keep what the record says of them."""
        items, failed = list[StudyItem](), list[FailedChain]()
        for name, results in upstream.items():
            failed += [FailedChain(name, chain.label, str(why)) for chain, why in results.failed.items()]
            for chain, manifests in results.done.items():
                items += [StudyItem(name, f"{chain.label}#{i}", manifest.key) for i, manifest in enumerate(manifests)]
        items += [item for item in self._record.items if item.stage not in upstream]
        failed += [chain for chain in self._record.failed if chain.stage not in upstream]
        self._record = replace(self._record, items=tuple(items), failed=tuple(failed))
        self._store.write_study(self._record)


def recorded_study(store: Store, name: str) -> StudyRecord:
    """Return the record of a study that a user names.

    Raises:
        PuddleError: the store has no such study, or its record is damaged; the message lists the studies there are.
    """
    names = store.studies()
    if name in names and (record := store.read_study(name)) is not None:
        return record
    if name in names:
        raise PuddleError(f"study {name}: {store.record_path(name)}: expected a record, found no file. {WRITTEN_ANEW}")
    if not names:
        raise PuddleError(f"study {name!r}: {store.root} holds no study yet. `puddle study` makes one.")
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.4)
    advice = f"; did you mean {close[0]}?" if close else ""
    raise PuddleError(f"study {name!r}: {store.root} holds {', '.join(names)}{advice}")


def preset_of(source: str) -> str:
    """Return the preset that a study's settings come from, by its record; "" if they come from a file."""
    return source.removeprefix("preset ") if source.startswith("preset ") else ""


def settings_of(record: StudyRecord) -> Settings:
    """Return the settings of a recorded study: RecordedSettings where it used code that is not here.

    Raises:
        PuddleError: they are those of another version of puddle, with other fields.
    """
    try:
        recorded = RecordedSettings.model_validate(record.settings)
        return recorded if recorded.missing else Settings.model_validate(record.settings, extra="ignore")
    except ValidationError as error:
        first = error.errors()[0]
        why = with_failures(f"{'.'.join(map(str, first['loc']))}: {first['msg']}")
        raise PuddleError(
            f"study {record.name}: expected settings of this version of puddle, got those of another ({why}). "
            "The version that made the study can read them."
        ) from None


def setting_changes(old: Any, new: Any, name: str = "") -> list[tuple[str, Any, Any]]:
    """Return the dotted name, the old and the new value of every setting that differs, in JSON values of a group."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        names = [*new, *(gone for gone in old if gone not in new)]
        return [
            change
            for one in names
            for change in setting_changes(old.get(one), new.get(one), f"{name}.{one}".strip("."))
        ]
    return [] if old == new else [(name, old, new)]


def differences(old: Settings, new: Settings) -> list[str]:
    """Return one line per setting that differs between two settings, with both values."""
    changes = setting_changes(old.model_dump(mode="json"), new.model_dump(mode="json"))
    return [f"{name}: {json.dumps(one)} → {json.dumps(other)}" for name, one, other in changes]
