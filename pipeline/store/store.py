"""The store: a folder of items and of the studies that use them.

::

    store.json                                    schema version; marks a folder as a store
    commit.lock                                   held during a commit
    use.lock                                      shared by drivers and readers; exclusive for removing items
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
import fcntl
import os
import platform
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import TypeAdapter, ValidationError

from pipeline.errors import DamagedArtifact, PuddleError
from pipeline.store import disk
from pipeline.store.encoding import Json, decode_document, encode_document
from pipeline.store.items import Items, check_name
from pipeline.store.manifest import Manifest, are_file_names

STORE_SCHEMA, STORE_VERSION = "puddle.store", 1
STUDY_SCHEMA, STUDY_VERSION = "puddle.study", 1

WRITTEN_ANEW = "Its results are safe; running the study again rewrites the file."  # advice for a study's record
_GONE_GROUPS = {"pilot"}  # settings of earlier versions, on which no result of today's stages depends


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
    settings: Mapping[str, Any]
    items: tuple[StudyItem, ...]
    failed: tuple[FailedChain, ...] = ()
    source: str = ""  # "preset laptop" or the path of a settings file; empty if unknown


class _Use(NamedTuple):
    study: str
    label: str  # of the item, in the study
    driven: bool  # whether a process drives the study


@dataclass(frozen=True)
class Store(Items):
    """An existing store; see :meth:`open`."""

    @classmethod
    def open(cls, root: Path, *, create: bool) -> Store:
        """Open a store, or create one in a new or empty folder."""
        root = disk.resolved(root)
        path = root / "store.json"
        with disk.explained("opening the store", root):
            if not path.exists():
                if not create:
                    advice = "Name the folder of an existing store, or run a study to create one."
                    raise PuddleError(f"{root}: expected a store (a folder with store.json), found none. {advice}")
                cls._create(root)
            try:
                decode_document(path.read_bytes(), schema=STORE_SCHEMA, version=STORE_VERSION, source=str(path))
            except DamagedArtifact as damage:
                raise DamagedArtifact(f"{damage}. Copy store.json from any other store: all are alike.") from None
        return cls(root)

    @classmethod
    def _create(cls, root: Path) -> None:
        disk.make_folders(next(path for path in (root, *root.parents) if path.exists()), root)
        own = {"commit.lock", "use.lock", "store.json", disk.temporary(root / "store.json").name}
        strangers = sorted({path.name for path in root.iterdir()} - own)
        if strangers and not (root / "store.json").exists():  # in this order: another process may be making it
            raise PuddleError(
                f"{root}: expected a store, or an empty folder to create one in, found {', '.join(strangers[:3])}"
                f"{' and more' if len(strangers) > 3 else ''}. Choose another folder."
            )
        with disk.locked(root / "commit.lock"):
            disk.place(root / "store.json", encode_document({}, schema=STORE_SCHEMA, version=STORE_VERSION))

    def verify(
        self, study: str | None = None, *, checked: Callable[[int], object] = lambda n_bytes: None
    ) -> list[PuddleError]:
        """Hash everything again: items, records of studies and their exported reports; or those of one study.

        Args:
            study: name of the only study to verify.
            checked: called with the length of each item after it has been verified [bytes].

        Returns:
            One error for each problem. Damage to an item, or its loss, is a DamagedArtifact with its stage and key. A
            file of a newer puddle is an OtherVersion, because discarding would not mend it.
        """
        wrong: list[PuddleError] = []
        uses = {item: list[_Use]() for item in (self.items() if study is None else ())}
        for name in self._names("studies") if study is None else [study]:
            driven = self.driver_of(name) is not None  # asked first: a driver writes the record, then the report
            try:
                record = self.read_study(name)
                if record is None and not driven:
                    path = self.study_path(name) / "study.json"
                    raise DamagedArtifact(f"{path}: expected a study's record, found no file. {WRITTEN_ANEW}")
            except PuddleError as error:
                wrong.append(error)
                continue
            for item in record.items if record else ():
                uses.setdefault((item.stage, item.key), []).append(_Use(name, item.label, driven))
        for (stage, key), used in sorted(uses.items()):
            try:
                manifest = self.verified(stage, key)
                if manifest is None:
                    what = f"the manifest of study {used[0].study}'s {stage} {used[0].label}"
                    raise self._damaged(stage, key, f"{self.manifest_path(stage, key)}: expected {what}, found no file")
                checked(sum(entry.n_bytes for entry in manifest.files.values()))
                for use in used if stage == "report" else ():
                    if not use.driven:
                        wrong += self._check_export(use.study, manifest)
            except PuddleError as error:
                wrong.append(error)
                checked(0)
        return wrong

    def _check_export(self, name: str, manifest: Manifest) -> Iterator[PuddleError]:
        """Yield what differs in a study's exported report from the item that it is a copy of."""
        for file, entry in manifest.files.items():
            path = self.export_path(name) / file
            with disk.explained("reading the report", path):
                found = disk.digest_of(path) if path.is_file() else "no file"
            if found != entry.sha256:
                advice = f"It is a copy of a file in the store: running study {name} restores it."
                yield DamagedArtifact(f"{path}: expected SHA-256 {entry.sha256}, found {found}. {advice}")

    def size_bytes(self) -> int:
        """Return the total length of all files [bytes]."""
        return disk.size_bytes(self.root)

    # -- studies -------------------------------------------------------------------------------------------------------

    def write_study(self, record: StudyRecord) -> None:
        """Write the record of a study, replacing the earlier one."""
        name, folder = record.name, self.study_path(record.name)
        rows = {"items": list(map(list, record.items)), "failed": list(map(list, record.failed))}
        body: dict[str, Json] = {"name": name, "settings": record.settings, "source": record.source, **rows}
        data = encode_document(body, schema=STUDY_SCHEMA, version=STUDY_VERSION)
        with disk.explained(f"writing the record of study {name}", self.root), disk.locked(self.root / "commit.lock"):
            disk.make_folders(self.root, folder)
            disk.place(folder / "study.json", data)

    def read_study(self, name: str) -> StudyRecord | None:
        """Return the record of a study, or None if there is no study of that name.

        A damaged record raises DamagedArtifact, and one of another version of puddle OtherVersion.
        """
        path = self.study_path(name) / "study.json"
        with disk.explained(f"reading study {name}", self.root):
            try:
                data = path.read_bytes()
            except FileNotFoundError:
                return None
        try:
            body = decode_document(data, schema=STUDY_SCHEMA, version=STUDY_VERSION, source=str(path))
            record = _RECORD.validate_python(body)
            if record.name != name:
                raise DamagedArtifact(f"{path}: it is that of study {record.name}")
            kept = {group: chosen for group, chosen in record.settings.items() if group not in _GONE_GROUPS}
            return replace(record, settings=kept)
        except (DamagedArtifact, ValidationError) as error:
            raise DamagedArtifact(
                f"{path}: expected a study's name, settings and items: {error}. {WRITTEN_ANEW}"
            ) from None

    def studies(self, *, recorded: bool = True) -> list[str]:
        """Return the names of the studies that have a record, or of those that have lost it."""
        names = self._names("studies")
        return [name for name in names if os.path.lexists(self.study_path(name) / "study.json") == recorded]

    @contextlib.contextmanager
    def lock_study(self, name: str) -> Iterator[None]:
        """Become the only process that drives a study; the error names another that does.

        The store is locked first, so that `puddle gc` never sees the folder of a study that has only just begun.
        """
        folder = self.study_path(name)
        with contextlib.ExitStack() as held:
            with disk.explained(f"locking study {name}", self.root):
                self._share(held)
                disk.make_folders(self.root, folder)
                descriptor = disk.try_lock(folder / "driver.lock")
                if descriptor is None:
                    raise PuddleError(
                        f"study {name} is driven by {self.driver_of(name) or 'a process that has just ended'}. "
                        f"Wait until it ends, or stop it (Ctrl-C); its committed results are safe."
                    )
                held.callback(os.close, descriptor)
                os.ftruncate(descriptor, 0)
                os.write(descriptor, _signature())
            yield

    @contextlib.contextmanager
    def lock_to_read(self) -> Iterator[None]:
        """Prevent the removal of items while they are read; refuse to read while `puddle gc` runs.

        Nothing is written, so that a store on a read-only disk, or another user's, can be read too. A store without a
        lock file has never been driven on this machine, and nothing has been removed from it.
        """
        with contextlib.ExitStack() as held:
            with disk.explained("locking the store", self.root), contextlib.suppress(FileNotFoundError):
                self._share(held, only_ask=True)
            yield

    def _share(self, held: contextlib.ExitStack, *, only_ask: bool = False) -> None:
        in_use = disk.try_lock(self.root / "use.lock", kind=fcntl.LOCK_SH, only_ask=only_ask)
        if in_use is None:
            raise PuddleError(f"{self.root}: another process of puddle is removing items. Wait until it ends.")
        held.callback(os.close, in_use)

    @contextlib.contextmanager
    def lock_all(self) -> Iterator[None]:
        """Become the only process that uses the store, so that no study is driven; the error names a driver."""
        with disk.explained("locking the store", self.root):
            descriptor = disk.try_lock(self.root / "use.lock")
        if descriptor is None:
            drivers = {name: self.driver_of(name) for name in self._names("studies")}
            driven = [f"study {name} is driven by {driver}" for name, driver in drivers.items() if driver]
            raise PuddleError(
                f"{self.root} is in use: {'; '.join(driven) or 'another process of puddle reads it'}. Wait until it "
                f"ends, or stop it (Ctrl-C); its committed results are safe."
            )
        try:
            yield
        finally:
            os.close(descriptor)

    def driver_of(self, name: str) -> str | None:
        """Describe the process that drives a study; None if none does."""
        path = self.study_path(name) / "driver.lock"
        with disk.explained(f"asking who drives study {name}", self.root):
            try:
                descriptor = disk.try_lock(path, kind=fcntl.LOCK_SH, only_ask=True)
            except FileNotFoundError:
                return None
            if descriptor is None:
                return path.read_text() or "another process, which has only just started"
            os.close(descriptor)
            return None

    def export(self, name: str, files: Mapping[str, bytes]) -> Path:
        """Write a study's report to its folder, over the earlier one, and return the folder."""
        if not are_file_names(files):
            raise ValueError(f"study {name}: expected file names like index.html, got {sorted(files)}")
        folder = self.export_path(name)
        with disk.explained(f"exporting study {name}", self.root), disk.locked(self.root / "commit.lock"):
            disk.make_folders(self.root, folder)
            for file, data in sorted(files.items()):
                disk.place(folder / file, data)
        return folder

    def export_path(self, name: str) -> Path:
        """Return the folder of a study's report, which :meth:`export` creates."""
        return self.study_path(name) / "report"

    def study_path(self, name: str) -> Path:
        """Return a study's folder, whether or not it exists."""
        return self.root / "studies" / check_name(name, "study")


_RECORD = TypeAdapter(StudyRecord)


def _signature() -> bytes:
    started = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    words = f"process {os.getpid()} on {platform.node()} since {started} ({' '.join(sys.argv)})"
    return words.encode(errors="replace")
