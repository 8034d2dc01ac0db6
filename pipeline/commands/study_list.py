"""The list of a store's studies."""

import datetime
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pipeline.commands.study_status import study_status
from pipeline.config.loading import load, preset_names, preset_path
from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.store.store import Store
from pipeline.workflow.record import differences, preset_of, settings_of

_WIDTH = 80
_MOST_DIFFERENCES = 6


@dataclass(frozen=True)
class ListedStudy:
    """What the list shows of a study."""

    study: str
    source: str = ""  # "preset laptop" or the path of a settings file
    preset: str = ""  # the preset that the settings differ least from, or that they come from
    differences: tuple[str, ...] = ()  # settings that differ from the preset's: name, value of the preset, own value
    progress: str = ""
    done: bool = False
    n_failed: int = 0  # chains
    driver: str | None = None
    changed: str = ""  # when its record last changed, ISO 8601
    page: str | None = None  # address of its page, if it has one
    problem: str = ""  # why nothing else is known


def list_studies(store: Store) -> Iterator[ListedStudy]:
    """Describe every study of a store, which the caller has locked; a damaged one by its problem alone."""
    presets = {name: load(Settings, preset_path(name)).model_dump(mode="json") for name in preset_names()}
    for name in store.studies():
        try:
            record = store.read_study(name)
            if record is None:  # removed a moment ago
                continue
            status = study_status(settings_of(record), store, record, with_diverged=False)
        except PuddleError as problem:
            yield ListedStudy(name, problem=str(problem))
            continue
        changes = {
            preset_name: differences(_unnamed(preset), _unnamed(record.settings))
            for preset_name, preset in presets.items()
        }
        preset = preset_of(record.source)
        if preset not in changes:
            preset = min(changes, key=lambda preset_name: len(changes[preset_name]))
        page = store.export_path(name) / "index.html"
        changed = (store.study_path(name) / "study.json").stat().st_mtime
        yield ListedStudy(
            name,
            record.source,
            preset,
            tuple(changes[preset]),
            status.short,
            status.is_done,
            sum(len(stage.failed) for stage in status.stages),
            status.driver,
            datetime.datetime.fromtimestamp(changed).astimezone().isoformat(sep=" ", timespec="seconds"),
            page.as_uri() if page.is_file() else None,
        )
    for name in store.studies(recorded=False):
        yield ListedStudy(name, problem=f"{store.study_path(name)} has no record, study.json")


def _unnamed(settings: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in settings.items() if name != "name"}


def describe(one: ListedStudy) -> Iterator[str]:
    """Describe a study in lines of 80 columns; addresses and paths are never cut."""
    if one.problem:
        yield f"{one.study}: {one.problem}"
        return
    yield f"{one.study}: {one.progress}"
    if one.n_failed:
        yield f"  {one.n_failed} chains failed; `puddle status --study {one.study}` names them"
    n_more = len(one.differences) - _MOST_DIFFERENCES
    shown = "; ".join(one.differences[:_MOST_DIFFERENCES]) + (f"; and {n_more} more" if n_more > 0 else "")
    is_preset = one.preset == preset_of(one.source)
    if one.source and not is_preset:
        yield f"  settings from {one.source}"
    what = f"preset {one.preset}" if is_preset else f"nearest preset {one.preset}"
    text = f"{what}, changed: {shown}" if shown else f"{what}, unchanged"
    yield from textwrap.wrap(text, _WIDTH, initial_indent="  ", subsequent_indent="    ", break_long_words=False)
    yield f"  last change {one.changed}"
    if one.page:
        yield f"  {one.page}"
