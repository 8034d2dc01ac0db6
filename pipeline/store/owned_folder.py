"""A folder that puddle makes for the user: written once it is complete, and never over anything but its own kind.

A manifest in the folder tells that puddle made it, and gives the SHA-256 of every file. The next run replaces those
files; files that the user added or changed stay.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.errors import PuddleError
from pipeline.store import disk
from pipeline.store.encoding import Json, decode_document, encode_document

_DRAFT = ".puddle-"  # begins the name of the temporary folder, which a killed process leaves
_OF_NOBODY = (_DRAFT, disk.LOST_AND_FOUND)


@dataclass
class NewFolder:
    """A folder while it is written to a temporary place."""

    path: Path
    preserved: list[str] = field(default_factory=list)  # a line for each file that the user changed, once in place

    def write(self, name: str, content: bytes) -> None:
        """Write a file."""
        disk.write(self.place(name), content)

    def place(self, name: str) -> Path:
        """Return the path at which to write a file."""
        path = self.path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path


@dataclass(frozen=True)
class FolderKind:
    """A kind of folder."""

    word: str  # what messages call it
    schema: str
    version: int
    manifest: str  # name of the file that makes a folder one of this kind

    def check_place(self, folder: Path) -> Path:
        """Return the resolved path of a folder that is new, empty or of this kind. Raises PuddleError for any other."""
        self._earlier(folder)
        return folder.expanduser().resolve()

    def _earlier(self, folder: Path) -> Mapping[str, str]:
        """Return the SHA-256 of every file that an earlier run wrote, by name."""
        source = folder / self.manifest
        if source.is_file():
            data = disk.read(source)
            return dict(decode_document(data, schema=self.schema, version=self.version, source=str(source))["files"])
        if folder.is_file():
            found = "a file"
        elif not folder.parent.is_dir():
            found = f"no {folder.parent}"
        elif folder.is_dir() and any(not path.name.startswith(_OF_NOBODY) for path in folder.iterdir()):
            found = f"no {source}"
        else:
            return {}
        expected = f"expected a new folder or {self.word}"
        raise PuddleError(f"{folder}: {expected}, found {found}. Choose another one with --out.")

    @contextlib.contextmanager
    def replace(self, folder: Path, manifest: Mapping[str, Json]) -> Iterator[NewFolder]:
        """Write files to a temporary folder on the same disk, then move them, the manifest last.

        Args:
            folder: where they will be; PuddleError if it can't be used.
            manifest: content of its manifest, without the digests of the files.

        Yields:
            The new folder; its files are put in place when the block ends without an error.
        """
        folder = self.check_place(folder)
        disk_of = folder if folder.is_dir() else folder.parent  # a folder may be a disk of its own, as a volume is
        with tempfile.TemporaryDirectory(dir=disk_of, prefix=_DRAFT) as draft:
            new = NewFolder(Path(draft))
            yield new
            written = [path for path in sorted(new.path.rglob("*")) if path.is_file()]
            digests = {path.relative_to(new.path).as_posix(): disk.digest_of(path) for path in written}
            earlier = self._earlier(folder)
            for name in sorted({*digests, *earlier}):
                path = folder / name
                found = disk.digest_of(path) if path.is_file() else None
                if found not in (None, earlier.get(name), digests.get(name)):
                    disk.rename(path, own := disk.unused(path))
                    new.preserved.append(f"Preserved {name}, which you had changed, as {own.name}.")
                if name in digests:
                    path.parent.mkdir(parents=True, exist_ok=True)
                    disk.rename(new.path / name, path)
                else:
                    disk.unlink(path)
            whole = encode_document({**manifest, "files": digests}, schema=self.schema, version=self.version)
            disk.place(folder / self.manifest, whole)
