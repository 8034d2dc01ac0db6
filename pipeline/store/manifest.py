"""Manifests: what the store says of an item."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from pipeline.errors import DamagedArtifact, Irreproducible, OtherVersion, PuddleError
from pipeline.store.encoding import Json, canonical_json, decode_sealed, digest, encode_sealed, key_of

MANIFEST_SCHEMA, MANIFEST_VERSION = "puddle.manifest", 1

MANIFEST = "manifest.json"
MAX_FILE_BYTES = 2**30
"""Of a file of an item, which is read into memory whole. A piece of work makes megabytes."""

_FILE_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}(\.[a-z0-9]{1,16})?")
_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class FileEntry:
    """One file of an item: its SHA-256 and its length."""

    sha256: str
    n_bytes: int


@dataclass(frozen=True)
class Manifest:
    """What an item is.

    Attributes:
        stage: the stage that it belongs to.
        key: the SHA-256 of its identity.
        identity: what determines it: the stage, its version, the settings it uses, its inputs' digests, its seed.
        files: by name.
        environment: where it was made.
        record: what else is worth keeping, such as the seconds that it took.
    """

    stage: str
    key: str
    identity: Mapping[str, Any]
    files: Mapping[str, FileEntry]
    environment: Mapping[str, str]
    record: Mapping[str, Any]

    @property
    def digest(self) -> str:
        """SHA-256 of the names and contents of the files, and of nothing else: what later work depends on."""
        return digest(canonical_json([[name, entry.sha256] for name, entry in sorted(self.files.items())]))


def are_file_names(names: Iterable[str]) -> bool:
    """Tell whether the names may be an item's files: 1 to 64 of a-z, 0-9, _ and -, and at most one suffix."""
    return all(_FILE_NAME.fullmatch(name) and name != MANIFEST for name in names)


def encode_manifest(manifest: Manifest) -> bytes:
    """Return a manifest as a sealed document."""
    files: dict[str, Json] = {
        name: {"sha256": entry.sha256, "bytes": entry.n_bytes} for name, entry in manifest.files.items()
    }
    return encode_sealed(
        {
            "stage": manifest.stage,
            "key": manifest.key,
            "identity": manifest.identity,
            "files": files,
            "digest": manifest.digest,
            "environment": manifest.environment,
            "record": manifest.record,
        },
        schema=MANIFEST_SCHEMA,
        version=MANIFEST_VERSION,
    )


def decode_manifest(data: bytes, *, stage: str, key: str, source: str) -> Manifest:
    """Return the manifest of an item.

    Raises:
        DamagedArtifact: where it is not what was written, or is another item's.
        OtherVersion: where another puddle wrote it.
    """
    try:
        body = decode_sealed(data, schema=MANIFEST_SCHEMA, version=MANIFEST_VERSION, source=source)
    except (DamagedArtifact, OtherVersion):
        raise
    except PuddleError as error:  # a foreign document where ours was
        raise DamagedArtifact(str(error)) from None
    try:  # the seal tells of damage, not of who wrote it: the document may have any content
        files = {name: _entry(name, entry) for name, entry in body["files"].items()}
        for name in ("identity", "environment", "record"):
            body[name].items()
        _check_seconds(body["record"].get("seconds", 0.0))
        manifest = Manifest(body["stage"], body["key"], body["identity"], files, body["environment"], body["record"])
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise DamagedArtifact(f"{source}: expected a manifest's fields: {error!r}") from None
    if (manifest.stage, manifest.key) != (stage, key) or key_of(manifest.identity) != key:
        raise DamagedArtifact(f"{source}: expected {stage} {key}, came {manifest.stage} {manifest.key}")
    if not files or not are_file_names(files):
        raise DamagedArtifact(f"{source}: expected file names like weights.safetensors, came {sorted(files)}")
    return manifest


def _entry(name: str, said: Mapping[str, Any]) -> FileEntry:
    """Return what a manifest says of a file, if it can be true of one."""
    sha256, n_bytes = said["sha256"], said["bytes"]
    if not (isinstance(sha256, str) and _SHA256.fullmatch(sha256)):
        raise ValueError(f"expected a SHA-256 of {name:.80} in 64 hexadecimal digits, came {sha256!s:.80}")
    if type(n_bytes) is not int or not 0 <= n_bytes <= MAX_FILE_BYTES:
        raise ValueError(f"expected 0 to {MAX_FILE_BYTES} bytes of {name:.80}, came {n_bytes!s:.80}")
    return FileEntry(sha256, n_bytes)


def _check_seconds(said: Any) -> None:
    if type(said) not in (int, float) or not 0 <= said <= sys.float_info.max:
        raise ValueError(f"expected seconds, 0 or more, came {said!s:.80}")


def refuse_other_content(kept: Manifest, new: Manifest) -> None:
    """Check that the same work gave the same content.

    Raises:
        Irreproducible: names the files that differ, both digests and where each was made.
    """
    if kept.digest == new.digest:
        return
    differ = [name for name in sorted({*kept.files, *new.files}) if kept.files.get(name) != new.files.get(name)]
    made = [
        f"{one.digest} ({one.environment.get('cpu')}, commit {one.environment.get('commit')})" for one in (kept, new)
    ]
    raise Irreproducible(
        f"{new.stage} {new.key}: the same work gave other bytes than before, in {', '.join(differ)}: expected digest "
        f"{made[0]}, came {made[1]}. What was kept stays. This is a defect of puddle or of a machine: please report it."
    )
