"""puddle studies: what a store holds."""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from dataclasses import asdict, dataclass

from pipeline.commands.options import DEFAULT_STORE, AsJson, StorePath, with_options
from pipeline.commands.status import study_status
from pipeline.commands.terminal import print_json, to_stdout
from pipeline.errors import PuddleError
from pipeline.stages.report import PAGE
from pipeline.store.store import Store
from pipeline.workflow.record import recorded_study, settings_of


@with_options
def studies(store: StorePath = DEFAULT_STORE, as_json: AsJson = False) -> None:
    """List the studies of a store: progress, settings, page."""
    opened = Store.open(store, create=False)
    listed = list(list_studies(opened))
    if as_json:
        print_json({"store": str(opened.root), "studies": [asdict(one) for one in listed]})
        return
    noun = "study" if len(listed) == 1 else "studies"
    to_stdout(f"{len(listed) or 'no'} {noun} in {opened.root}")
    for one in listed:
        to_stdout("", *describe(one))


@dataclass(frozen=True)
class ListedStudy:
    """What the list shows of a study."""

    study: str
    source: str = ""  # "preset laptop" or the path of a settings file
    progress: str = ""
    done: bool = False
    changed: str = ""  # when its record last changed, ISO 8601
    page: str | None = None  # address of its page, if it has one
    problem: str = ""  # why nothing else is known


def list_studies(store: Store) -> Iterator[ListedStudy]:
    """Describe every study of a store; a damaged one by its problem alone."""
    for name in store.studies():
        try:
            record = recorded_study(store, name)
            status = study_status(settings_of(record), store, record, with_diverged=False)
        except PuddleError as problem:
            yield ListedStudy(name, problem=str(problem))
            continue
        page = store.export_path(name) / PAGE
        changed = datetime.datetime.fromtimestamp(store.record_path(name).stat().st_mtime).astimezone()
        yield ListedStudy(
            name,
            record.source,
            status.short,
            status.is_done,
            changed.isoformat(sep=" ", timespec="seconds"),
            page.as_uri() if page.is_file() else None,
        )


def describe(one: ListedStudy) -> Iterator[str]:
    """Describe a study in lines; addresses and paths are never cut."""
    yield f"{one.study}: {one.problem or one.progress}"
    if one.source:
        yield f"  settings from {one.source}"
    if one.changed:
        yield f"  last change {one.changed}"
    if one.page:
        yield f"  {one.page}"
