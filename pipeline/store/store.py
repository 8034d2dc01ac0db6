"""The store: a folder of items and of the studies that use them.

::

    store.json                                    schema version; marks a folder as a store
    commit.lock                                   held during a commit
    use.lock                                      shared by drivers; exclusive for removing items
    items/<stage>/<key[:2]>/<key>/<file>          files of an item
    items/<stage>/<key[:2]>/<key>/manifest.json   written last; without it the item does not exist
    studies/<name>/study.json                     settings of a study, and the keys of its items
    studies/<name>/driver.lock                    held and signed by the process that drives the study
    studies/<name>/report/                        the exported report; other files in it are left alone

Several processes may use one store, and so may several computers if the locks of their common file system work.
"""

from __future__ import annotations

import contextlib
import datetime
import os
import platform
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import TypeAdapter, ValidationError

from pipeline.errors import DamagedArtifact, PuddleError, without_password
from pipeline.store import disk
from pipeline.store.encoding import decode_document, encode_document
from pipeline.store.items import Items, check_name

STORE_SCHEMA, STORE_VERSION = "puddle.store", 1
STUDY_SCHEMA, STUDY_VERSION = "puddle.study", 1

WRITTEN_ANEW = "Its results are safe; running the study again rewrites the file."  # advice for a study's record

_EXPORTED = ".files"  # in a study's folder of the report: the names of what is there
_WAIT = "Wait until it ends, or stop it (Ctrl-C); its committed results are safe."


class StudyItem(NamedTuple):
    """One item of a study: stage, label and key."""

    stage: str
    label: str
    key: str


class FailedChain(NamedTuple):
    """A chain of a study that failed: stage, label and reason."""

    stage: str
    label: str
    why: str


@dataclass(frozen=True)
class StudyRecord:
    """A study's settings, its items, its failed chains, and where its settings come from."""

    name: str
    settings: Mapping[str, Any] = field(repr=False)
    items: tuple[StudyItem, ...] = field(repr=False)
    failed: tuple[FailedChain, ...] = ()
    source: str = ""  # "preset laptop" or the path of a settings file; empty if unknown


@dataclass(frozen=True)
class Store(Items):
    """An existing store; see :meth:`open`."""

    @classmethod
    def open(cls, root: Path, *, create: bool) -> Store:
        """Open a store, or create one in a new or empty folder."""
        root = root.expanduser().resolve()
        path = root / "store.json"
        if not path.exists() and create:
            cls._create(root)
        elif not path.exists():
            advice = "Name the folder of an existing store, or run a study to create one."
            raise PuddleError(f"{root}: expected a store (a folder with store.json), found none. {advice}")
        decode_document(disk.read(path), schema=STORE_SCHEMA, version=STORE_VERSION, source=str(path))
        return cls(root)

    @classmethod
    def _create(cls, root: Path) -> None:
        disk.make_folders(root)
        others = sorted(
            {path.name for path in root.iterdir()} - {"commit.lock", ".store.json.tmp", disk.LOST_AND_FOUND}
        )
        if others and not (root / "store.json").exists():  # in this order: another process may be making it
            raise PuddleError(
                f"{root}: expected a store, or an empty folder to create one in, found {', '.join(others[:3])}"
                f"{' and more' if len(others) > 3 else ''}. Choose another folder."
            )
        with disk.locked(root / "commit.lock"):
            disk.place(root / "store.json", encode_document({}, schema=STORE_SCHEMA, version=STORE_VERSION))

    def verify(self, *, checked: Callable[[], object] = lambda: None) -> list[PuddleError]:
        """Hash every item again, and read the records of studies.

        Args:
            checked: called after each item.

        Returns:
            One error for each problem. Damage to an item, or its loss, is a DamagedArtifact with its stage and key;
            discarding the item mends it, and no other problem.
        """
        wrong: list[PuddleError] = []
        items = dict.fromkeys(self.items(), "of no study")
        for name in self.studies():
            try:
                record = self.read_study(name)
                if record is None and self.driver_of(name) is None:
                    raise DamagedArtifact(f"{self.record_path(name)}: expected a record, found no file. {WRITTEN_ANEW}")
                for item in record.items if record else ():
                    items[item.stage, item.key] = f"study {name}: {item.stage} {item.label}"
            except PuddleError as error:
                wrong.append(error)
        for (stage, key), what in sorted(items.items()):
            try:
                if self.manifest(stage, key, hashed=True) is None:
                    raise self.damaged(stage, key, f"{self.manifest_path(stage, key)}: expected a manifest, found none")
            except DamagedArtifact as error:
                wrong.append(DamagedArtifact(f"{what}: {error}", stage=stage, key=key))
            except (PuddleError, OSError) as error:
                wrong.append(PuddleError(f"{what}: {error}"))
            checked()
        return wrong

    # -- studies -------------------------------------------------------------------------------------------------------

    def write_study(self, record: StudyRecord) -> None:
        """Write the record of a study, replacing the earlier one."""
        path = self.record_path(record.name)
        data = encode_document(_RECORD.dump_python(record, mode="json"), schema=STUDY_SCHEMA, version=STUDY_VERSION)
        with disk.locked(self.root / "commit.lock"):
            disk.make_folders(path.parent)
            disk.place(path, data)

    def read_study(self, name: str) -> StudyRecord | None:
        """Return the record of a study, or None if there is no study of that name.

        A damaged record raises DamagedArtifact, and one of another version of puddle OtherVersion.
        """
        path = self.record_path(name)
        try:
            data = disk.read(path)
            body = decode_document(data, schema=STUDY_SCHEMA, version=STUDY_VERSION, source=str(path))
            return _RECORD.validate_python(body)
        except FileNotFoundError:
            return None
        except (DamagedArtifact, KeyError, AttributeError, ValidationError) as error:
            raise DamagedArtifact(
                f"{path}: expected a study's name, settings and items: {error}. {WRITTEN_ANEW}"
            ) from None

    def studies(self) -> list[str]:
        """Return the names of the studies, also of one that has lost its record."""
        return self._names("studies")

    @contextlib.contextmanager
    def lock_study(self, name: str) -> Iterator[None]:
        """Become the only process that drives a study; the error names another that does.

        The store is locked first, so that `puddle gc` never sees the folder of a study that has only just begun.
        """

        def taken() -> str:
            driver = self.driver_of(name) or "a process that has just ended"
            return f"study {name} is driven by {driver}. {_WAIT}"

        def removing() -> str:
            return f"{self.root}: another process of puddle is removing items. Wait until it ends."

        folder = self.study_path(name)
        with disk.locked(self.root / "use.lock", shared=True, taken=removing):
            disk.make_folders(folder)
            with disk.locked(path := folder / "driver.lock", taken=taken):
                started = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
                command = without_password(" ".join(sys.argv))
                signature = f"process {os.getpid()} on {platform.node()} since {started} ({command})"
                with disk.named(path):
                    path.write_bytes(signature.encode(errors="replace"))
                yield

    @contextlib.contextmanager
    def lock_all(self) -> Iterator[None]:
        """Become the only process that uses the store, so that no study is driven; the error names a driver."""

        def taken() -> str:
            drivers = {name: self.driver_of(name) for name in self.studies()}
            driven = [f"study {name} is driven by {driver}" for name, driver in drivers.items() if driver]
            return f"{self.root} is in use: {'; '.join(driven) or 'another process of puddle removes items'}. {_WAIT}"

        with disk.locked(self.root / "use.lock", taken=taken):
            yield

    def driver_of(self, name: str) -> str | None:
        """Describe the process that drives a study; None if none does."""
        path = self.study_path(name) / "driver.lock"
        if not path.exists():
            return None
        with path.open() as file:
            try:
                free = disk.lock(file, shared=True)
            except PuddleError:  # there are no locks, so nothing drives here
                return None
            return None if free else file.read() or "another process, which has only just started"

    def export(self, name: str, files: Mapping[str, bytes]) -> Path:
        """Write a study's report to its folder in place of the earlier one, and return the folder."""
        folder = self.export_path(name)
        listed = folder / _EXPORTED
        with disk.locked(self.root / "commit.lock"):
            disk.make_folders(folder)
            earlier = set(disk.read(listed).decode().split("\n")) if listed.exists() else set()
            disk.place(listed, "\n".join(sorted(earlier | set(files))).encode())  # first, so that no file is forgotten
            for file, data in sorted(files.items()):
                disk.place(folder / file, data)
            for file in earlier - set(files):
                disk.unlink(folder / file)
            disk.place(listed, "\n".join(sorted(files)).encode())
        return folder

    def export_path(self, name: str) -> Path:
        """Return the folder of a study's report, which :meth:`export` creates."""
        return self.study_path(name) / "report"

    def record_path(self, name: str) -> Path:
        """Return the path of a study's record, whether or not it exists."""
        return self.study_path(name) / "study.json"

    def study_path(self, name: str) -> Path:
        """Return a study's folder, whether or not it exists."""
        return self.root / "studies" / check_name(name, "study")


_RECORD = TypeAdapter(StudyRecord)
