"""Manifests, which describe the items of a store."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pipeline.errors import DamagedArtifact
from pipeline.store.encoding import Json, canonical_json, decode_document, digest, encode_document, key_of

MANIFEST_SCHEMA, MANIFEST_VERSION = "puddle.manifest", 1

MANIFEST = "manifest.json"


@dataclass(frozen=True)
class FileEntry:
    """SHA-256 and length of one file of an item."""

    sha256: str
    n_bytes: int


@dataclass(frozen=True)
class Manifest:
    """Description of an item."""

    stage: str
    key: str  # SHA-256 of its identity
    identity: Mapping[str, Any]  # what determines it: stage, version, settings used, digests of its inputs, seed
    files: Mapping[str, FileEntry]
    environment: Mapping[str, str]  # versions, commit and CPU with which it was computed
    record: Mapping[str, Any]  # further facts, such as the seconds that it took; part of no key and no digest

    @property
    def digest(self) -> str:
        """SHA-256 of the files' names and contents, on which later work items depend."""
        return digest(canonical_json([[name, entry.sha256] for name, entry in sorted(self.files.items())]))


_PLAIN_FIELDS = ("stage", "key", "identity", "environment", "record")


def encode_manifest(manifest: Manifest) -> bytes:
    """Encode a manifest."""
    files: Json = {name: {"sha256": entry.sha256, "bytes": entry.n_bytes} for name, entry in manifest.files.items()}
    body: dict[str, Json] = {**vars(manifest), "files": files, "digest": manifest.digest}
    return encode_document(body, schema=MANIFEST_SCHEMA, version=MANIFEST_VERSION)


def decode_manifest(data: bytes, *, stage: str, key: str, source: str) -> Manifest:
    """Return the manifest of an item.

    Args:
        data: the document.
        stage, key: the item.
        source: the document's name in messages.

    Raises:
        DamagedArtifact: the document was changed, or describes another item.
        OtherVersion: another version of puddle wrote it.
    """
    body = decode_document(data, schema=MANIFEST_SCHEMA, version=MANIFEST_VERSION, source=source)
    try:
        files = {name: FileEntry(entry["sha256"], entry["bytes"]) for name, entry in body["files"].items()}
        manifest = Manifest(files=files, **{field: body[field] for field in _PLAIN_FIELDS})
        found = manifest.stage, manifest.key, key_of(manifest.identity), manifest.digest
    except (KeyError, TypeError, AttributeError) as error:
        raise DamagedArtifact(f"{source}: expected a manifest's fields: {error!r}") from None
    if found != (stage, key, key, body.get("digest")):
        expected = f"expected {stage} {key} of digest {body.get('digest')}"
        raise DamagedArtifact(f"{source}: {expected}, got {manifest.stage} {manifest.key} of digest {manifest.digest}")
    return manifest
