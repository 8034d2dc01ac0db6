"""The store: what was computed, by the key of the work that made it.

::

    store.json                                    the schema version: what makes a folder a store
    commit.lock                                   held for the moment of a commit
    use.lock                                      shared by all drivers; held alone by what removes items
    items/<stage>/<key[:2]>/<key>/<file>          an item's files
    items/<stage>/<key[:2]>/<key>/manifest.json   written last: without it, the item never happened
    studies/<name>/study.json                     the settings of a study, and the keys of its items
    studies/<name>/driver.lock                    held by the process that drives the study, which it names
    studies/<name>/report/                        what a person looks at

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
import re
import stat
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline import disk
from pipeline.artifacts import (
    Json,
    canonical_json,
    decode_json,
    decode_sealed,
    digest,
    encode_json,
    encode_sealed,
    key_of,
)
from pipeline.errors import DamagedArtifact, PuddleError
from pipeline.manifest import (
    MANIFEST,
    FileEntry,
    Manifest,
    are_file_names,
    decode_manifest,
    encode_manifest,
    refuse_other_content,
)
from pipeline.provenance import environment

STORE_SCHEMA, STORE_VERSION = "puddle.store", 1
STUDY_SCHEMA, STUDY_VERSION = "puddle.study", 1

_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")
_KEY = re.compile(r"[0-9a-f]{64}")


def check_name(name: str, what: str) -> str:
    """Return a name of a study or a stage, or refuse it.

    Raises:
        PuddleError: where it is not made of a-z, 0-9, _ and -, 1 to 64 of them, the first a letter or a digit.
    """
    if not _NAME.fullmatch(name):
        raise PuddleError(f"{what} {name!r}: expected 1 to 64 of a-z, 0-9, _ and -, beginning with a letter or a digit")
    return name


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
    set_aside: tuple[SetAside, ...] = ()


@dataclass(frozen=True)
class Store:
    """A store that exists; see :meth:`open`."""

    root: Path

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

    # -- items ---------------------------------------------------------------------------------------------------

    def commit(
        self,
        stage: str,
        key: str,
        identity: Mapping[str, Json],
        files: Mapping[str, bytes],
        *,
        record: Mapping[str, Json],
    ) -> Manifest:
        """Keep an item: all of it, or nothing.

        Args:
            stage: the stage that it belongs to.
            key: ``key_of(identity)``.
            identity: what determines it.
            files: their contents by name.
            record: what else is worth keeping; not part of the digest.

        Returns:
            Its manifest: the first one, where the item was there already.

        Raises:
            Irreproducible: where it was there with other contents, which stay.
            PuddleError: where the disk is full, read-only or failing.
        """
        if key != key_of(identity):
            raise ValueError(f"{stage} {key}: expected the key of its identity, {key_of(identity)}")
        if not files or not are_file_names(files):
            raise ValueError(f"{stage} {key}: expected file names like weights.safetensors, came {sorted(files)}")
        manifest = Manifest(
            stage=check_name(stage, "stage"),
            key=key,
            identity=decode_json(canonical_json(identity), "identity"),  # as it will be read: tuples become lists
            files={name: FileEntry(digest(data), len(data)) for name, data in sorted(files.items())},
            environment=environment(),
            record=decode_json(canonical_json(record), "record"),
        )
        folder = self._item(stage, key)
        with disk.explained(f"keeping {stage} {key[:12]}", self.root), disk.locked(self.root / "commit.lock"):
            if kept := self._kept(stage, key):
                refuse_other_content(kept, manifest)
                return kept
            disk.make_folders(self.root, folder)
            self._clear(folder)
            for name, data in sorted(files.items()):
                disk.place(folder / name, data)
            disk.place(folder / MANIFEST, encode_manifest(manifest))
        return manifest

    def _kept(self, stage: str, key: str) -> Manifest | None:
        """Return the manifest of a whole item. A damaged one counts as none: its successor is in the caller's hand."""
        try:
            return self._verified(stage, key)
        except DamagedArtifact:
            return None

    def _verified(self, stage: str, key: str) -> Manifest | None:
        """Return an item's manifest, its files read and found whole."""
        manifest = self.manifest(stage, key)
        if manifest is not None:
            for name in manifest.files:
                self.read(manifest, name)
        return manifest

    def manifest(self, stage: str, key: str) -> Manifest | None:
        """Return an item's manifest, or None where the item was never committed.

        The manifest itself is verified, and that its files are there in their full length; their contents are
        verified when they are read.

        Raises:
            DamagedArtifact: names the path. The item must be neither trusted nor forgotten: say so, discard it and
                compute it again.
        """
        manifest = self.listing(stage, key)
        with disk.explained(f"reading {stage} {key[:12]}", self.root), _damage(stage, key):
            for name, entry in manifest.files.items() if manifest is not None else ():
                file = disk.inside(self._item(stage, key), name)
                n_bytes = file.stat().st_size if file.is_file() else None
                if n_bytes != entry.n_bytes:
                    came = "no file" if n_bytes is None else f"{n_bytes} bytes"
                    raise DamagedArtifact(f"{file}: expected {entry.n_bytes} bytes, came {came}")
        return manifest

    def listing(self, stage: str, key: str) -> Manifest | None:
        """Return an item's manifest, verified, whatever has become of its files; otherwise as :meth:`manifest`."""
        path = disk.inside(self._item(stage, key), MANIFEST)
        with disk.explained(f"reading {stage} {key[:12]}", self.root), _damage(stage, key):
            try:
                data = disk.read_document(path)
            except FileNotFoundError:
                return None
            except disk.NotAFileError as error:
                raise DamagedArtifact(f"{path}: expected a manifest, came {error.strerror}") from error
            return decode_manifest(data, stage=stage, key=key, source=str(path))

    def read(self, manifest: Manifest, name: str) -> bytes:
        """Return a file's content, verified.

        Raises:
            DamagedArtifact: where it is not what was committed.
        """
        path = disk.inside(self._item(manifest.stage, manifest.key), name)
        entry = manifest.files[name]
        with disk.explained(f"reading {name}", self.root), _damage(manifest.stage, manifest.key):
            try:
                data = disk.read(path, at_most=entry.n_bytes)
            except (FileNotFoundError, disk.NotAFileError) as error:
                raise DamagedArtifact(f"{path}: expected {entry.n_bytes} bytes, came {error.strerror}") from error
            if digest(data) != entry.sha256:
                raise DamagedArtifact(f"{path}: expected SHA-256 {entry.sha256}, came {digest(data)}")
        return data

    def discard(self, stage: str, key: str) -> None:
        """Forget an item, so that it is computed again. What depends on it stays: it depends on the content."""
        folder = self._item(stage, key)
        with disk.explained(f"discarding {stage} {key[:12]}", self.root), disk.locked(self.root / "commit.lock"):
            self._clear(folder)

    def remove(self, stage: str, key: str) -> None:
        """Discard an item and its folder, for good. The caller holds the store alone; see :meth:`lock_all`."""
        folder = self._item(stage, key)
        with disk.explained(f"removing {stage} {key[:12]}", self.root), disk.locked(self.root / "commit.lock"):
            self._clear(folder)
            disk.rmdir(folder)
            disk.fsync(folder.parent)

    @staticmethod
    def _clear(folder: Path) -> None:
        """Empty an item's folder, its manifest first: a half discarded item never happened either."""
        if folder.is_dir():
            for path in sorted(folder.iterdir(), key=lambda path: (path.name != MANIFEST, path.name)):
                remove = disk.rmdir if _is_folder(path) else disk.unlink
                remove(path)
                disk.fsync(folder)

    def stages(self) -> list[str]:
        """Return the names of the stages that have items."""
        return self._names("items")

    def keys(self, stage: str, *, committed: bool = True) -> Iterator[str]:
        """Iterate over the keys of a stage's items in their order, damaged ones included.

        Args:
            stage: its name.
            committed: whether to give those that were committed, or those whose commit never came to its end.
        """
        for prefix in self._names("items", check_name(stage, "stage")):
            for key in self._names("items", stage, prefix):
                if not (_KEY.fullmatch(key) and key.startswith(prefix)):
                    continue
                if os.path.lexists(self._item(stage, key) / MANIFEST) == committed:
                    yield key

    def item_bytes(self, stage: str, key: str) -> int:
        """Return the length of an item's files together."""
        return size_bytes(self._item(stage, key))

    def verify(self, *, checked: Callable[[int], None] = lambda n_bytes: None) -> list[PuddleError]:
        """Hash everything again; return what is wrong, which is empty where all is well.

        Damage to an item is a :class:`DamagedArtifact` that names its stage and key. A symbolic link, or a file of a
        newer puddle, is a plain PuddleError: discarding would not mend it. Where there are links, nothing else is
        looked at.

        Args:
            checked: is told the length of everything once it has been looked at.
        """
        links = sorted(path.relative_to(self.root) for path in self.root.rglob("*") if path.is_symlink())
        checks: list[tuple[Path, Callable[[], object]]]
        checks = [(self.root / link, functools.partial(disk.inside, self.root, *link.parts)) for link in links]
        if not links:
            items = [(stage, key) for stage in self.stages() for key in self.keys(stage)]
            checks += [(self._item(*item), functools.partial(self._verified, *item)) for item in items]
            checks += [(self._study(name), functools.partial(self.read_study, name)) for name in self.studies()]
        wrong = []
        for path, check in checks:
            try:
                check()
            except PuddleError as error:
                wrong.append(error)
            checked(size_bytes(path))
        return wrong

    def size_bytes(self) -> int:
        """Return the length of all files together."""
        return size_bytes(self.root)

    # -- studies -------------------------------------------------------------------------------------------------

    def write_study(
        self,
        name: str,
        settings: Mapping[str, Json],
        items: Sequence[StudyItem],
        set_aside: Sequence[SetAside] = (),
    ) -> None:
        """Keep what a study is made of and lacks, in place of what was kept before."""
        folder = self._study(name)
        listed: list[Json] = [[item.stage, item.label, item.key] for item in items]
        given_up: list[Json] = [[lost.stage, lost.label, lost.why] for lost in set_aside]
        body: dict[str, Json] = {"name": name, "settings": settings, "items": listed, "set_aside": given_up}
        data = encode_sealed(body, schema=STUDY_SCHEMA, version=STUDY_VERSION)
        if len(data) > disk.MAX_DOCUMENT_BYTES:
            raise PuddleError(f"study {name}: {len(items)} pieces are too many. Cut its work into larger ones.")
        with disk.explained(f"keeping study {name}", self.root), disk.locked(self.root / "commit.lock"):
            disk.make_folders(self.root, folder)
            disk.place(disk.inside(folder, "study.json"), data)

    def read_study(self, name: str) -> StudyRecord | None:
        """Return what a study is made of, or None where there is none of that name.

        Raises:
            DamagedArtifact: names the file. Running the study again writes it anew.
        """
        path = disk.inside(self._study(name), "study.json")
        with disk.explained(f"reading study {name}", self.root):
            try:
                data = disk.read_document(path)
            except FileNotFoundError:
                return None
        try:
            body = decode_sealed(data, schema=STUDY_SCHEMA, version=STUDY_VERSION, source=str(path))
            items = tuple(StudyItem(*item) for item in body["items"])
            set_aside = tuple(SetAside(*lost) for lost in body.get("set_aside", ()))  # early stores have none
            if not isinstance(body["settings"], dict) or not all(_is_item(item) for item in items):
                raise DamagedArtifact("it is well sealed, and they are none")  # whoever seals may be anyone
            if not all(isinstance(word, str) for lost in set_aside for word in (lost.stage, lost.label, lost.why)):
                raise DamagedArtifact("it is well sealed, and what was set aside has no names")
            if body["name"] != name:
                raise DamagedArtifact(f"came those of study {body['name']}")
            return StudyRecord(name, body["settings"], items, set_aside)
        except (DamagedArtifact, KeyError, TypeError) as error:
            raise DamagedArtifact(
                f"{path}: expected a study's name, settings and items: {error}. "
                f"Its results are safe; running the study again writes the file anew."
            ) from None

    def studies(self, *, recorded: bool = True) -> list[str]:
        """Return the names of the studies: those that have a record, or those that have lost it."""
        names = self._names("studies")
        return [name for name in names if os.path.lexists(self._study(name) / "study.json") == recorded]

    @contextlib.contextmanager
    def lock_study(self, name: str) -> Iterator[None]:
        """Be the one process that drives a study.

        Raises:
            PuddleError: where another process does; it is named. Or where `puddle gc` is at work.
        """
        folder = self._study(name)
        with disk.explained(f"locking study {name}", self.root), contextlib.ExitStack() as held:
            disk.make_folders(self.root, folder)
            descriptor = disk.try_lock(disk.inside(folder, "driver.lock"))
            if descriptor is None:
                raise PuddleError(
                    f"study {name} is driven by {self.driver_of(name) or 'a process that has just ended'}. "
                    f"Wait for its end, or stop it (Ctrl-C); its finished work is kept."
                )
            held.callback(os.close, descriptor)
            in_use = disk.try_lock(self.root / "use.lock", kind=fcntl.LOCK_SH)
            if in_use is None:
                raise PuddleError(f"{self.root}: `puddle gc` is removing what no study needs. Wait for its end.")
            held.callback(os.close, in_use)
            os.ftruncate(descriptor, 0)
            os.write(descriptor, _own_name())
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
        path = disk.inside(self._study(name), "driver.lock")
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
        """Put files where people look at them, in place of earlier ones; return the folder."""
        if not are_file_names(files):
            raise ValueError(f"study {name}: expected file names like index.html, came {sorted(files)}")
        folder = self.export_path(name)
        with disk.explained(f"exporting study {name}", self.root), disk.locked(self.root / "commit.lock"):
            disk.make_folders(self.root, folder)
            for file, data in sorted(files.items()):
                disk.place(disk.inside(folder, file), data)
        return folder

    def export_path(self, name: str) -> Path:
        """Return the folder of a study's report, which :meth:`export` makes."""
        return disk.inside(self._study(name), "report")

    # -- paths ---------------------------------------------------------------------------------------------------

    def _item(self, stage: str, key: str) -> Path:
        if not _KEY.fullmatch(key):
            raise PuddleError(f"{stage}: expected a key of 64 hexadecimal digits, came {key!r}")
        return disk.inside(self.root, "items", check_name(stage, "stage"), key[:2], key)

    def _study(self, name: str) -> Path:
        return disk.inside(self.root, "studies", check_name(name, "study"))

    def _names(self, *parts: str) -> list[str]:
        """Return the names in a folder that could be ours, in their order."""
        folder = disk.inside(self.root, *parts)
        with disk.explained("listing", folder):
            try:
                return sorted(path.name for path in folder.iterdir() if _NAME.fullmatch(path.name) and _is_folder(path))
            except FileNotFoundError:
                return []


def _is_item(item: StudyItem) -> bool:
    """Tell whether what a record lists can be an item."""
    if not all(isinstance(word, str) for word in (item.stage, item.label, item.key)):
        return False
    return _NAME.fullmatch(item.stage) is not None and _KEY.fullmatch(item.key) is not None


def size_bytes(folder: Path) -> int:
    """Return the length of all files in a folder and below."""
    total = 0
    for path in folder.rglob("*"):
        with contextlib.suppress(FileNotFoundError):  # a commit renames its temporary files meanwhile
            found = path.lstat()
            total += found.st_size if stat.S_ISREG(found.st_mode) else 0
    return total


def _is_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink()


def _own_name() -> bytes:
    """Return who this process is, for others to read."""
    started = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return encode_json({"pid": os.getpid(), "host": platform.node(), "started": started, "command": " ".join(sys.argv)})


@contextlib.contextmanager
def _damage(stage: str, key: str) -> Iterator[None]:
    """Say of any damage in which item it is."""
    try:
        yield
    except DamagedArtifact as damage:
        message = f"{damage}. Item {stage} {key[:12]} is damaged and has to be computed again."
        raise DamagedArtifact(message, stage=stage, key=key) from damage
