"""A folder that puddle makes for the user: written completely or not at all, and never over anything but its own kind.

A manifest in the folder tells that puddle made it, and gives the SHA-256 of every file. The next run replaces those
files; files that the user added or changed stay.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.errors import PuddleError
from pipeline.store import disk
from pipeline.store.encoding import Json, check_format, decode_json, encode_json


@dataclass
class NewFolder:
    """A folder while it is written beside the place where it will be."""

    path: Path
    preserved: list[str] = field(default_factory=list)  # a line for each of the user's files, once it is in place

    def write(self, name: str, content: bytes) -> None:
        """Write a file."""
        path = self.place(name)
        disk.write(path, content)
        disk.fsync(path)

    def place(self, name: str) -> Path:
        """Return the path at which to write a file."""
        path = self.path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def digests(self) -> dict[str, str]:
        """Return the SHA-256 of every file by name."""
        return {
            path.relative_to(self.path).as_posix(): disk.digest_of(path)
            for path in sorted(self.path.rglob("*"))
            if path.is_file()
        }


@dataclass(frozen=True)
class FolderKind:
    """A kind of folder."""

    word: str  # what messages call it
    schema: str
    version: int
    manifest: str  # name of the file that makes a folder one of this kind

    def check_place(self, folder: Path) -> Path:
        """Return the resolved path of a folder that is new, empty or of this kind. Raises PuddleError for any other."""
        with disk.explained("looking for the folder", folder, advice="run the same command again"):
            return self._checked(folder)

    def _checked(self, folder: Path) -> Path:
        expected = f"expected a new folder or {self.word}"
        other = "Choose another one with --out."
        if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
            raise PuddleError(f"{folder}: {expected}, found a file or a link. {other}")
        place = disk.resolved(folder)
        if not folder.exists():
            if not folder.parent.is_dir():
                advice = "Create it, or choose another folder with --out."
                raise PuddleError(f"{folder}: {folder.parent} does not exist. {advice}")
            return place
        if Path.cwd().is_relative_to(place):  # the folder is replaced, and the shell would stay in the old one
            raise PuddleError(f"{folder}: can't replace the current directory. Choose another folder with --out.")
        names = sorted(path.name for path in folder.iterdir())
        if not names:
            return place
        if self.manifest not in names:
            raise PuddleError(f"{folder}: {expected}, found {', '.join(names[:3])} and no {self.manifest}. {other}")
        source = str(folder / self.manifest)
        document = decode_json(disk.read(folder / self.manifest), source)
        check_format(document, schema=self.schema, version=self.version, source=source)
        return place

    @contextlib.contextmanager
    def replace(self, folder: Path, manifest: Mapping[str, Json]) -> Iterator[NewFolder]:
        """Write a folder beside its place, then rename it into place.

        Files of the replaced folder that the user added or changed are preserved.

        Args:
            folder: where it will be.
            manifest: content of its manifest, without the digests of the files.

        Yields:
            The new folder; its files are put in place when the block ends without an error.

        Raises:
            PuddleError: the place can't be used, or the disk fails; what was there before is still there.
        """
        folder = self.check_place(folder)
        new = NewFolder(folder.with_name(f".{folder.name}.{os.getpid()}.new"))
        old = folder.with_name(f".{folder.name}.{os.getpid()}.old")
        with disk.explained(f"writing {self.word}", folder, advice="run the same command again to replace it"):
            try:
                new.path.mkdir()
                yield new
                digests: dict[str, Json] = {**new.digests()}
                self._preserve(folder, new, digests)
                named = {**manifest, "schema": self.schema, "version": self.version, "files": digests}
                new.write(self.manifest, encode_json(named))
                if folder.exists():
                    disk.rename(folder, old)
                disk.rename(new.path, folder)
                disk.fsync(folder.parent)
            except BaseException:  # also on Ctrl-C: the user's files have no other copy
                if old.exists():
                    if folder.exists():
                        disk.rename(folder, new.path)
                    disk.rename(old, folder)
                raise
            finally:
                shutil.rmtree(new.path, ignore_errors=True)
            shutil.rmtree(old, ignore_errors=True)

    def _preserve(self, folder: Path, new: NewFolder, made: Mapping[str, Json]) -> None:
        """Copy the files that the user added or changed, under the names that they will have in the new folder."""
        if not (folder / self.manifest).is_file():
            return
        manifest = decode_json(disk.read(folder / self.manifest), str(folder / self.manifest))
        digests = manifest["files"] if isinstance(manifest.get("files"), dict) else {}
        for path in sorted(folder.rglob("*")):
            name = path.relative_to(folder).as_posix()
            if name == self.manifest or path.is_symlink() or not path.is_file():
                continue
            if (found := disk.digest_of(path)) == digests.get(name) or found == made.get(name):
                continue
            new_name, number = name, 0
            while (new.path / new_name).exists():
                number += 1
                new_name = path.with_stem(f"{path.stem}-yours-{number}").relative_to(folder).as_posix()
            new.write(new_name, path.read_bytes())
            changed = "" if new_name == name else f", which you had changed, as {new_name}"
            new.preserved.append(f"Preserved {name}{changed}.")
