"""Items: results, stored under the key of the work item that produced them.

The manifest is written last, and every read checks the SHA-256 that it gives: an item is complete or does not exist.
"""

import contextlib
import os
import re
import shlex
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import DamagedArtifact, PuddleError
from pipeline.store import disk
from pipeline.store import manifest as manifests
from pipeline.store.encoding import Json, canonical_json, decode_json, digest, key_of
from pipeline.store.manifest import MANIFEST, FileEntry, Manifest
from pipeline.store.provenance import environment

NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")
KEY = re.compile(r"[0-9a-f]{64}")


def check_name(name: str, what: str) -> str:
    """Return the name of a study or stage if it is valid; raise a PuddleError otherwise."""
    if not NAME.fullmatch(name):
        raise PuddleError(f"{what} {name!r}: expected 1 to 64 of a-z, 0-9, _ and -, beginning with a letter or a digit")
    return name


@dataclass(frozen=True)
class Items:
    """Items of an existing store."""

    root: Path

    def commit(
        self,
        stage: str,
        key: str,
        identity: Mapping[str, Json],
        files: Mapping[str, bytes],
        *,
        record: Mapping[str, Json],
    ) -> Manifest:
        """Commit an item, completely or not at all.

        Args:
            stage: stage that the item belongs to.
            key: ``key_of(identity)``.
            identity: everything that determines the item.
            files: contents by file name.
            record: further facts; not part of the digest.

        Returns:
            Its manifest; if the item was committed before, the earlier one.

        Raises:
            Irreproducible: it was committed before with other contents, which stay.
            PuddleError: the disk is full, read-only or failing.
            ValueError: the key is not that of the identity, or a file name is invalid.
        """
        if key != key_of(identity):
            raise ValueError(f"{stage} {key}: expected the key of its identity, {key_of(identity)}")
        if not files or not manifests.are_file_names(files):
            raise ValueError(f"{stage} {key}: expected file names like weights.safetensors, got {sorted(files)}")
        manifest = Manifest(
            stage=check_name(stage, "stage"),
            key=key,
            identity=decode_json(canonical_json(identity), "identity"),  # as it will be read back: tuples become lists
            files={name: FileEntry(digest(data), len(data)) for name, data in sorted(files.items())},
            environment=environment(),
            record=decode_json(canonical_json(record), "record"),
        )
        folder = self._item(stage, key)
        with disk.explained(f"committing {stage} {key[:12]}", self.root), disk.locked(self.root / "commit.lock"):
            with contextlib.suppress(DamagedArtifact):  # a damaged one counts as missing: here is its successor
                if committed := self.verified(stage, key):
                    manifests.refuse_other_content(committed, manifest)
                    return committed
            self._clear(folder)
            disk.make_folders(self.root, folder)
            for name, data in sorted(files.items()):
                disk.place(folder / name, data)
            disk.place(folder / MANIFEST, manifests.encode_manifest(manifest))
        return manifest

    def manifest(self, stage: str, key: str) -> Manifest | None:
        """Return an item's manifest, or None if the item was never committed; raise DamagedArtifact if it is damaged.

        This looks for every file, and at its length; the content is verified when it is read.
        """
        return self._manifest(stage, key, _check_length)

    def verified(self, stage: str, key: str) -> Manifest | None:
        """Return an item's manifest as :meth:`manifest` does, and hash its files, too."""
        return self._manifest(stage, key, _check_content)

    def _manifest(self, stage: str, key: str, check: Callable[[Path, FileEntry], None]) -> Manifest | None:
        folder = self._item(stage, key)
        with self._damage(stage, key):
            try:
                data = (folder / MANIFEST).read_bytes()
            except FileNotFoundError:
                return None
            manifest = manifests.decode_manifest(data, stage=stage, key=key, source=str(folder / MANIFEST))
            for name, entry in manifest.files.items():
                check(folder / name, entry)
        return manifest

    def read(self, manifest: Manifest, name: str) -> bytes:
        """Return the content of a file; raise DamagedArtifact if it differs from what was committed."""
        path, entry = self._item(manifest.stage, manifest.key) / name, manifest.files[name]
        with self._damage(manifest.stage, manifest.key):
            _check_length(path, entry)
            data = path.read_bytes()
            _compare(path, f"SHA-256 {entry.sha256}", f"SHA-256 {digest(data)}")
        return data

    def discard(self, stage: str, key: str) -> None:
        """Remove an item, so that it is computed again; items that depend on its content stay."""
        folder = self._item(stage, key)
        with disk.explained(f"discarding {stage} {key[:12]}", self.root), disk.locked(self.root / "commit.lock"):
            self._clear(folder)

    @staticmethod
    def _clear(folder: Path) -> None:
        """Remove an item's folder, its manifest first, so that a partly removed item does not exist either."""
        if folder.is_dir():
            for path in sorted(folder.iterdir(), key=lambda path: path.name != MANIFEST):
                remove = disk.rmdir if _is_folder(path) else disk.unlink
                remove(path)
                disk.fsync(folder)
            disk.rmdir(folder)
            disk.fsync(folder.parent)

    def stages(self) -> list[str]:
        """Return the names of the stages that have items."""
        return self._names("items")

    def keys(self, stage: str, *, committed: bool = True) -> Iterator[str]:
        """Yield the sorted keys of a stage's items, damaged ones too; or of those whose commit was interrupted."""
        for prefix in self._names("items", check_name(stage, "stage")):
            for key in self._names("items", stage, prefix):
                valid = KEY.fullmatch(key) and key.startswith(prefix)
                if valid and os.path.lexists(self._item(stage, key) / MANIFEST) == committed:
                    yield key

    def items(self, *, committed: bool = True) -> Iterator[tuple[str, str]]:
        """Yield stage and key of every item; or of those whose commit was interrupted."""
        yield from ((stage, key) for stage in self.stages() for key in self.keys(stage, committed=committed))

    def item_bytes(self, stage: str, key: str) -> int:
        """Return the total length of an item's files [bytes]."""
        return disk.size_bytes(self._item(stage, key))

    def _damaged(self, stage: str, key: str, what: str) -> DamagedArtifact:
        """Return the error for a damaged or missing item, with advice."""
        discard = shlex.join(["puddle", "verify", "--discard", "--store", str(self.root)])
        return DamagedArtifact(
            f"{what}. It must be computed again; nothing else is lost. A study that needs it does so itself; otherwise "
            f"`{discard}` discards what is damaged, and `puddle study` with the study's settings computes it again.",
            stage=stage,
            key=key,
        )

    @contextlib.contextmanager
    def _damage(self, stage: str, key: str) -> Iterator[None]:
        """Explain a disk that can't be read, and add the item and advice to the message of any damage."""
        try:
            with disk.explained(f"reading {stage} {key[:12]}", self.root):
                yield
        except DamagedArtifact as damage:
            raise self._damaged(stage, key, f"{damage}. Item {stage} {key[:12]} is damaged") from damage

    # -- paths ---------------------------------------------------------------------------------------------------------

    def manifest_path(self, stage: str, key: str) -> Path:
        """Return the path of an item's manifest, whether or not the item is committed."""
        return self._item(stage, key) / MANIFEST

    def _item(self, stage: str, key: str) -> Path:
        if not KEY.fullmatch(key):
            raise PuddleError(f"{stage}: expected a key of 64 hexadecimal digits, got {key!r}")
        return self.root / "items" / check_name(stage, "stage") / key[:2] / key

    def _names(self, *parts: str) -> list[str]:
        """Return the valid folder names in a folder, sorted."""
        folder = self.root.joinpath(*parts)
        with disk.explained("listing", folder):
            try:
                return sorted(path.name for path in folder.iterdir() if NAME.fullmatch(path.name) and _is_folder(path))
            except FileNotFoundError:
                return []


def _check_length(path: Path, entry: FileEntry) -> None:
    _compare(path, f"{entry.n_bytes} bytes", f"{path.stat().st_size} bytes" if path.is_file() else "no file")


def _check_content(path: Path, entry: FileEntry) -> None:
    _check_length(path, entry)
    _compare(path, f"SHA-256 {entry.sha256}", f"SHA-256 {disk.digest_of(path)}")


def _compare(path: Path, expected: str, found: str) -> None:
    if found != expected:
        raise DamagedArtifact(f"{path}: expected {expected}, got {found}")


def _is_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink()
