"""The store: a folder of items, and of the studies that they are for.

::

    store.json                                    the schema version: what makes a folder a store
    commit.lock                                   held for the moment of a commit
    use.lock                                      shared by drivers and readers; held alone by what removes items
    items/<stage>/<key[:2]>/<key>/<file>          an item's files
    items/<stage>/<key[:2]>/<key>/manifest.json   written last: without it, the item never happened
    studies/<name>/study.json                     the settings of a study, and the keys of its items
    studies/<name>/driver.lock                    held by the process that drives the study, which it names
    studies/<name>/report/                        what a person looks at; their own files beside it are left alone

A file is written beside its place, flushed to the disk, read back and renamed, so that a process may die anywhere.
Every read checks the SHA-256 that the manifest gives. Several processes may use one store; several computers may, if
their common file system has locks that work.
"""

from __future__ import annotations

import contextlib
import datetime
import fcntl
import functools
import os
import platform
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.errors import DamagedArtifact, OtherVersion, PuddleError
from pipeline.store import disk
from pipeline.store.encoding import Json, decode_json, decode_sealed, encode_json, encode_sealed
from pipeline.store.items import KEY, NAME, Items, check_name
from pipeline.store.manifest import MAX_FILE_BYTES, are_file_names

STORE_SCHEMA, STORE_VERSION = "puddle.store", 1
STUDY_SCHEMA, STUDY_VERSION = "puddle.study", 1

WRITTEN_ANEW = "Its results are safe; running the study again writes the file anew."
"""What to do where a study's record is damaged or gone."""

_GC_IS_AT_WORK = "`puddle gc` is removing what no study needs. Wait for its end."


@dataclass(frozen=True)
class StudyItem:
    """One item of a study: its stage, what people call it, its key."""

    stage: str
    label: str
    key: str


@dataclass(frozen=True)
class SetAside:
    """Work of a study that was given up: its stage, what people call it, why."""

    stage: str
    label: str
    why: str


@dataclass(frozen=True)
class StudyRecord:
    """What a study is made of: its settings and its items; and what it lacks."""

    name: str
    settings: Mapping[str, Any]
    items: tuple[StudyItem, ...]
    failed: tuple[SetAside, ...] = ()


@dataclass(frozen=True)
class Store(Items):
    """A store that exists; see :meth:`open`."""

    @classmethod
    def open(cls, root: Path, *, create: bool) -> Store:
        """Open a store, or make one in a new or empty folder.

        Raises:
            PuddleError: where there is none, or one of a newer schema, or it cannot be made.
        """
        root = root.expanduser().resolve()
        with disk.explained("opening the store", root):
            if not (root / "store.json").exists():
                if not create:
                    raise PuddleError(
                        f"{root}: expected a store (a folder with store.json), found none. "
                        f"Give the folder of an existing store, or run a study to make one."
                    )
                cls._create(root)
            for name in ("mlflow.db", "mlflow.lock", "mlartifacts"):  # MLflow would follow a link
                disk.inside(root, name)
            path = disk.inside(root, "store.json")
            try:
                decode_sealed(disk.read_document(path), schema=STORE_SCHEMA, version=STORE_VERSION, source=str(path))
            except DamagedArtifact as damage:
                raise DamagedArtifact(f"{damage}. Copy any other store's store.json: it holds no more.") from None
        return cls(root)

    @classmethod
    def _create(cls, root: Path) -> None:
        existing = next(path for path in (root, *root.parents) if path.exists())
        if not existing.is_dir():
            raise PuddleError(f"{root}: expected a folder for the store; {existing} is a file. Choose another folder.")
        with contextlib.suppress(OSError):  # who made it may have died before it was safe; or it is not ours to sync
            disk.fsync(existing.parent)
        disk.make_folders(existing, root)
        own = {"commit.lock", "use.lock", "store.json", disk.temporary(root / "store.json").name}
        strangers = sorted({path.name for path in root.iterdir()} - own)
        if strangers and not (root / "store.json").exists():  # in this order: another process may be making it
            raise PuddleError(
                f"{root}: expected a store, or an empty folder to make one in, found {', '.join(strangers[:3])}"
                f"{' and more' if len(strangers) > 3 else ''}. Choose another folder."
            )
        with disk.locked(root / "commit.lock"):
            if not (root / "store.json").exists():
                disk.place(root / "store.json", encode_sealed({}, schema=STORE_SCHEMA, version=STORE_VERSION))

    def verify(self, *, checked: Callable[[int], None] = lambda n_bytes: None) -> list[PuddleError]:
        """Hash everything again; return what is wrong, which is empty where all is well.

        Damage to an item is a :class:`DamagedArtifact` that names its stage and key. A symbolic link, or a file of a
        newer puddle, is a plain PuddleError: discarding would not mend it. Where there are links, nothing else is
        looked at.

        Args:
            checked: is told the length of everything once it has been looked at.
        """
        wrong = []
        for path, check in self._checks():
            try:
                check()
            except PuddleError as error:
                wrong.append(error)
            checked(disk.size_bytes(path))
        return wrong

    def bytes_to_verify(self) -> int:
        """Return the length of what :meth:`verify` looks at; MLflow's mirror of it is not."""
        return sum(disk.size_bytes(path) for path, _ in self._checks())

    def _checks(self) -> list[tuple[Path, Callable[[], object]]]:
        """List what can be verified, and how."""
        links = self.links()
        if links:
            return [(self.root / link, functools.partial(disk.inside, self.root, *link.parts)) for link in links]
        items = [(stage, key) for stage in self.stages() for key in self.keys(stage)]
        return [
            *((self._item(*item), functools.partial(self._verified, *item)) for item in items),
            *((self.study_path(name), functools.partial(self.read_study, name)) for name in self.studies()),
        ]

    def links(self) -> list[Path]:
        """Return the symbolic links in the store, as paths in it. There should be none."""
        return sorted(path.relative_to(self.root) for path in disk.below(self.root) if path.is_symlink())

    def size_bytes(self) -> int:
        """Return the length of all files together."""
        return disk.size_bytes(self.root)

    # -- studies -------------------------------------------------------------------------------------------------------

    def write_study(
        self, name: str, settings: Mapping[str, Json], items: Sequence[StudyItem], failed: Sequence[SetAside] = ()
    ) -> None:
        """Keep what a study is made of and lacks, in place of what was kept before."""
        folder = self.study_path(name)
        listed: list[Json] = [[item.stage, item.label, item.key] for item in items]
        given_up: list[Json] = [[lost.stage, lost.label, lost.why] for lost in failed]
        body: dict[str, Json] = {"name": name, "settings": settings, "items": listed, "failed": given_up}
        data = encode_sealed(body, schema=STUDY_SCHEMA, version=STUDY_VERSION)
        if len(data) > disk.MAX_DOCUMENT_BYTES:
            raise PuddleError(f"study {name}: {len(items)} pieces are too many. Cut its work into larger ones.")
        with disk.explained(f"keeping study {name}", self.root), disk.locked(self.root / "commit.lock"):
            disk.make_folders(self.root, folder)
            path = disk.inside(folder, "study.json")
            if path.is_dir():
                disk.rmdir(path)  # one that holds something is somebody's: it fails
            disk.place(path, data)

    def read_study(self, name: str) -> StudyRecord | None:
        """Return what a study is made of, or None where there is none of that name.

        Raises:
            DamagedArtifact: names the file. Running the study again writes it anew.
            OtherVersion: another puddle wrote it.
        """
        path = disk.inside(self.study_path(name), "study.json")
        with disk.explained(f"reading study {name}", self.root):
            try:
                data = disk.read_document(path)
            except FileNotFoundError:
                return None
            except disk.NotAFileError as error:
                raise DamagedArtifact(
                    f"{path}: expected a study's record, came {error.strerror}. {WRITTEN_ANEW}"
                ) from error
        try:
            body = decode_sealed(data, schema=STUDY_SCHEMA, version=STUDY_VERSION, source=str(path))
            items = tuple(StudyItem(*item) for item in body["items"])
            failed = tuple(SetAside(*lost) for lost in body.get("failed", ()))  # early stores have none
            if not isinstance(body["settings"], dict) or not all(_is_item(item) for item in items):
                raise DamagedArtifact("it is well sealed, and they are none")  # whoever seals may be anyone
            if not all(isinstance(word, str) for lost in failed for word in (lost.stage, lost.label, lost.why)):
                raise DamagedArtifact("it is well sealed, and what was set aside has no names")
            if body["name"] != name:
                raise DamagedArtifact(f"came those of study {body['name']}")
            return StudyRecord(name, body["settings"], items, failed)
        except OtherVersion:
            raise
        except (PuddleError, KeyError, TypeError) as error:  # damaged, or a foreign document where ours was
            raise DamagedArtifact(
                f"{path}: expected a study's name, settings and items: {error}. {WRITTEN_ANEW}"
            ) from None

    def studies(self, *, recorded: bool = True) -> list[str]:
        """Return the names of the studies: those that have a record, or those that have lost it."""
        names = self._names("studies")
        return [name for name in names if os.path.lexists(self.study_path(name) / "study.json") == recorded]

    @contextlib.contextmanager
    def lock_study(self, name: str) -> Iterator[None]:
        """Be the one process that drives a study.

        The store is held first: `puddle gc` never meets the folder of a study that has only just begun.

        Raises:
            PuddleError: where another process does; it is named. Or where `puddle gc` is at work.
        """
        folder = self.study_path(name)
        with disk.explained(f"locking study {name}", self.root), contextlib.ExitStack() as held:
            in_use = disk.try_lock(self.root / "use.lock", kind=fcntl.LOCK_SH)
            if in_use is None:
                raise PuddleError(f"{self.root}: {_GC_IS_AT_WORK}")
            held.callback(os.close, in_use)
            disk.make_folders(self.root, folder)
            descriptor = disk.try_lock(disk.inside(folder, "driver.lock"))
            if descriptor is None:
                raise PuddleError(
                    f"study {name} is driven by {self.driver_of(name) or 'a process that has just ended'}. "
                    f"Wait for its end, or stop it (Ctrl-C); its finished work is kept."
                )
            held.callback(os.close, descriptor)
            os.ftruncate(descriptor, 0)
            os.write(descriptor, _own_name())
            until_the_end = held.pop_all()
        with until_the_end:
            yield

    @contextlib.contextmanager
    def lock_to_read(self) -> Iterator[None]:
        """Keep what is read meanwhile from being removed.

        Nothing is written: a store on a read-only disk, or another user's, is read too. One without a lock file was
        never driven here, nor was anything removed.

        Raises:
            PuddleError: where `puddle gc` is at work.
        """
        with disk.explained("locking the store", self.root), contextlib.ExitStack() as held:
            with contextlib.suppress(FileNotFoundError):
                in_use = disk.try_lock(self.root / "use.lock", kind=fcntl.LOCK_SH, only_ask=True)
                if in_use is None:
                    raise PuddleError(f"{self.root}: {_GC_IS_AT_WORK}")
                held.callback(os.close, in_use)
            until_the_end = held.pop_all()
        with until_the_end:
            yield

    @contextlib.contextmanager
    def lock_all(self) -> Iterator[None]:
        """Be the one process that uses the store: no study is driven meanwhile.

        Raises:
            PuddleError: where one is; its driver is named.
        """
        with disk.explained("locking the store", self.root):
            descriptor = disk.try_lock(self.root / "use.lock")
        if descriptor is None:
            drivers = {name: self.driver_of(name) for name in self._names("studies")}
            driven = [f"study {name} is driven by {driver}" for name, driver in drivers.items() if driver]
            raise PuddleError(
                f"{self.root} is in use: {'; '.join(driven) or 'another process holds it'}. Wait for its end, or stop "
                f"it (Ctrl-C); its finished work is kept."
            )
        try:
            yield
        finally:
            os.close(descriptor)

    def driver_of(self, name: str) -> str | None:
        """Say which process drives a study, or None where none does."""
        path = disk.inside(self.study_path(name), "driver.lock")
        with disk.explained(f"asking who drives study {name}", self.root):
            try:
                descriptor = disk.try_lock(path, kind=fcntl.LOCK_SH, only_ask=True)
            except FileNotFoundError:
                return None
            if descriptor is not None:
                os.close(descriptor)
                return None
            try:
                who = decode_json(disk.read_document(path), str(path))
                return f"process {who['pid']} on {who['host']} since {who['started']} ({who['command']})"
            except (PuddleError, KeyError, TypeError):  # it holds the lock and has not written its name yet
                return "another process, which has only just begun"

    def export(self, name: str, files: Mapping[str, bytes]) -> Path:
        """Put files where people look at them, in place of earlier ones; return the folder.

        Of what else is there, what equals a file of a report in the store goes: an earlier export left it. A person's
        own files stay, and what it is not certain of.
        """
        if not are_file_names(files):
            raise ValueError(f"study {name}: expected file names like index.html, came {sorted(files)}")
        folder = self.export_path(name)
        with disk.explained(f"exporting study {name}", self.root), disk.locked(self.root / "commit.lock"):
            disk.make_folders(self.root, folder)
            for file, data in sorted(files.items()):
                disk.place(disk.inside(folder, file), data)
            for path in self._exported_before([path for path in folder.iterdir() if path.name not in files]):
                disk.unlink(path)
                disk.fsync(folder)
        return folder

    def _exported_before(self, paths: Sequence[Path]) -> list[Path]:
        """Choose the files that are copies of what a report in the store has under the same name."""
        reported = self._reported() if paths else set()
        names = {file for file, _ in reported}
        files = [path for path in sorted(paths) if path.name in names and _is_file(path)]
        return [path for path in files if (path.name, disk.digest_of(path, at_most=MAX_FILE_BYTES)) in reported]

    def _reported(self) -> set[tuple[str, str]]:
        """Return name and SHA-256 of the files of every report in the store."""
        reported: set[tuple[str, str]] = set()
        for key in self.keys("report"):
            with contextlib.suppress(PuddleError):  # damaged, or a newer puddle's: of another study, most likely
                listed = self.listing("report", key)
                reported |= {(file, entry.sha256) for file, entry in listed.files.items()} if listed else set()
        return reported

    def temporary(self) -> list[Path]:
        """Return the files of studies that were on their way to their place when a process died.

        They are known by the names that such files of ours have. What else is beside them is a person's.
        """
        reported = sorted({file for file, _ in self._reported()})
        found: list[Path] = []
        for name in self._names("studies"):
            files = [self.study_path(name) / "study.json", *(self.export_path(name) / file for file in reported)]
            found += [path for path in map(disk.temporary, files) if _is_file(path)]
        return found

    def export_path(self, name: str) -> Path:
        """Return the folder of a study's report, which :meth:`export` makes."""
        return disk.inside(self.study_path(name), "report")

    def study_path(self, name: str) -> Path:
        """Return a study's folder, whether or not it is there."""
        return disk.inside(self.root, "studies", check_name(name, "study"))


def _is_file(path: Path) -> bool:
    return path.is_file() and not path.is_symlink()


def _is_item(item: StudyItem) -> bool:
    """Tell whether what a record lists can be an item."""
    if not all(isinstance(word, str) for word in (item.stage, item.label, item.key)):
        return False
    return NAME.fullmatch(item.stage) is not None and KEY.fullmatch(item.key) is not None


def _own_name() -> bytes:
    """Return who this process is, for others to read."""
    started = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    command = " ".join(sys.argv).encode(errors="backslashreplace").decode()  # a path may be of bytes that are no text
    return encode_json({"pid": os.getpid(), "host": platform.node(), "started": started, "command": command})
