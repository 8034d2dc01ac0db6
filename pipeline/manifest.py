"""Manifests: what the store says of an item."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from pipeline.artifacts import Json, canonical_json, decode_sealed, digest, encode_sealed, key_of
from pipeline.errors import DamagedArtifact, Irreproducible, OtherVersion, PuddleError

MANIFEST_SCHEMA, MANIFEST_VERSION = "puddle.manifest", 1

MANIFEST = "manifest.json"
_FILE_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}(\.[a-z0-9]{1,16})?")


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
        files = {name: FileEntry(entry["sha256"], entry["bytes"]) for name, entry in body["files"].items()}
        for name in ("identity", "environment", "record"):
            body[name].items()
        float(body["record"].get("seconds", 0.0))
        manifest = Manifest(body["stage"], body["key"], body["identity"], files, body["environment"], body["record"])
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise DamagedArtifact(f"{source}: expected a manifest's fields: {error!r}") from None
    if (manifest.stage, manifest.key) != (stage, key) or key_of(manifest.identity) != key:
        raise DamagedArtifact(f"{source}: expected {stage} {key}, came {manifest.stage} {manifest.key}")
    if not files or not are_file_names(files):
        raise DamagedArtifact(f"{source}: expected file names like weights.safetensors, came {sorted(files)}")
    return manifest


def refuse_other_content(kept: Manifest, new: Manifest) -> None:
    """Check that the same work gave the same content.

    Raises:
        Irreproducible: names the files that differ, both digests and where each was made.
    """
    if kept.digest == new.digest:
        return
    differ = [name for name in sorted({*kept.files, *new.files}) if kept.files.get(name) != new.files.get(name)]
    made = [f"{one.digest} ({one.environment['cpu']}, commit {one.environment['commit']})" for one in (kept, new)]
    raise Irreproducible(
        f"{new.stage} {new.key}: the same work gave other bytes than before, in {', '.join(differ)}: expected digest "
        f"{made[0]}, came {made[1]}. What was kept stays. This is a defect of puddle or of a machine: please report it."
    )
