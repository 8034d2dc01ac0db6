"""Items: results, stored under the key of the work item that produced them.

The manifest is written last, and every read checks the SHA-256 that it gives: an item is complete or does not exist.
"""

import contextlib
import re
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import DamagedArtifact, Irreproducible, PuddleError
from pipeline.store import disk
from pipeline.store.encoding import Json, digest, key_of
from pipeline.store.manifest import MANIFEST, FileEntry, Manifest, decode_manifest, encode_manifest
from pipeline.store.provenance import environment

NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")


def check_name(name: str, what: str) -> str:
    """Return the name of a study or stage, or a key, if it is valid; raise a PuddleError otherwise."""
    if not NAME.fullmatch(name):
        raise PuddleError(f"{what} {name!r}: expected 1 to 64 of a-z, 0-9, _ and -, beginning with a letter or a digit")
    return name


@dataclass(frozen=True)
class Items:
    """Items of an existing store."""

    root: Path

    def commit(
        self, stage: str, identity: Mapping[str, Json], files: Mapping[str, bytes], *, record: Mapping[str, Json]
    ) -> Manifest:
        """Commit an item, completely or not at all.

        Args:
            stage: stage that the item belongs to.
            identity: everything that determines the item; its key is ``key_of(identity)``.
            files: contents by file name.
            record: further facts; not part of the digest.

        Returns:
            Its manifest; if the item was committed before, the earlier one.

        Raises:
            Irreproducible: it was committed before with other contents, which stay.
            OSError: the disk is full, read-only or failing.
        """
        key = key_of(identity)
        entries = {name: FileEntry(digest(data), len(data)) for name, data in files.items()}
        document = encode_manifest(Manifest(stage, key, identity, entries, environment(), record))
        manifest = decode_manifest(document, MANIFEST)  # as it will be read back
        folder = self._item(stage, key)
        with disk.locked(self.root / "commit.lock"):
            with contextlib.suppress(DamagedArtifact):  # a damaged one counts as missing: here is its successor
                if committed := self.manifest(stage, key, hashed=True):
                    if differ := sorted({name for name, _ in committed.files.items() ^ manifest.files.items()}):
                        raise Irreproducible(
                            f"{stage} {key}: computing this item again gave other bytes in {', '.join(differ)}: "
                            f"expected {committed.digest}, got {manifest.digest}. The committed item stays. This is a "
                            f"defect of puddle or of a machine: please report it."
                        )
                    return committed
            self._clear(folder)
            disk.make_folders(folder)
            for name, data in sorted(files.items()):
                disk.place(folder / name, data)
            disk.place(folder / MANIFEST, document)
        return manifest

    def manifest(self, stage: str, key: str, *, hashed: bool = False) -> Manifest | None:
        """Return an item's manifest, or None if the item was never committed; raise DamagedArtifact if it is damaged.

        This looks for every file, and at its length; with ``hashed`` also at its content, as :meth:`read` does.
        """
        path = self.manifest_path(stage, key)
        try:
            manifest = decode_manifest(disk.read(path), str(path))
        except FileNotFoundError:
            return None
        except DamagedArtifact as damage:
            raise self.damaged(stage, key, str(damage)) from None
        if (found := f"{manifest.stage} {manifest.key}") != (expected := f"{stage} {key}"):
            raise self.damaged(stage, key, f"{path}: expected {expected}, got {found}")
        for name, entry in manifest.files.items():
            file = path.with_name(name)
            found = f"{file.stat().st_size} bytes" if file.is_file() else "no file"
            if found != f"{entry.n_bytes} bytes":
                raise self.damaged(stage, key, f"{file}: expected {entry.n_bytes} bytes, got {found}")
            if hashed:
                self.read(manifest, name)
        return manifest

    def read(self, manifest: Manifest, name: str) -> bytes:
        """Return the content of a file; raise DamagedArtifact if it differs from what was committed."""
        path = self._item(manifest.stage, manifest.key) / name
        data = disk.read(path) if path.is_file() else b""
        if (found := digest(data)) != (expected := manifest.files[name].sha256):
            problem = f"{path}: expected SHA-256 {expected}, got SHA-256 {found}"
            raise self.damaged(manifest.stage, manifest.key, problem)
        return data

    def discard(self, stage: str, key: str) -> None:
        """Remove an item, so that it is computed again; items that depend on its content stay."""
        folder = self._item(stage, key)
        with disk.locked(self.root / "commit.lock"):
            self._clear(folder)

    @staticmethod
    def _clear(folder: Path) -> None:
        """Remove an item's folder, its manifest first, so that a partly removed item does not exist either."""
        if folder.is_dir():
            for path in sorted(folder.iterdir(), key=lambda path: path.name != MANIFEST):
                disk.unlink(path)
                disk.fsync(folder)
            disk.rmdir(folder)
            disk.fsync(folder.parent)

    def items(self, *, committed: bool = True) -> Iterator[tuple[str, str]]:
        """Yield stage and key of every item, damaged ones too; or of those whose commit was interrupted."""
        for stage in self._names("items"):
            for prefix in self._names("items", stage):
                for key in self._names("items", stage, prefix):
                    if self.manifest_path(stage, key).exists() == committed:
                        yield stage, key

    def item_bytes(self, stage: str, key: str) -> int:
        """Return the total length of an item's files [bytes]."""
        return sum(path.stat().st_size for path in self._item(stage, key).iterdir())

    def manifest_path(self, stage: str, key: str) -> Path:
        """Return the path of an item's manifest, whether or not the item is committed."""
        return self._item(stage, key) / MANIFEST

    def damaged(self, stage: str, key: str, problem: str) -> DamagedArtifact:
        """Return the error that names an item and what is wrong with it, and gives advice."""
        discard = shlex.join(["puddle", "verify", "--discard", "--store", str(self.root)])
        return DamagedArtifact(
            f"{problem}. Item {stage} {key[:12]} must be computed again; nothing else is lost. A study that needs it "
            f"does so itself; otherwise `{discard}` discards what is damaged, and `puddle study` with the study's "
            f"settings computes it again.",
            stage=stage,
            key=key,
        )

    def _item(self, stage: str, key: str) -> Path:
        return self.root / "items" / check_name(stage, "stage") / key[:2] / check_name(key, "key")

    def _names(self, *parts: str) -> list[str]:
        """Return the valid folder names in a folder, sorted."""
        folder = self.root.joinpath(*parts)
        try:
            return sorted(path.name for path in folder.iterdir() if NAME.fullmatch(path.name) and path.is_dir())
        except FileNotFoundError:
            return []
