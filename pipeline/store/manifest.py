"""Manifests, which describe the items of a store."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import TypeAdapter, ValidationError

from pipeline.errors import DamagedArtifact
from pipeline.store.encoding import canonical_json, decode_document, digest, encode_document

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


_MANIFEST = TypeAdapter(Manifest)


def encode_manifest(manifest: Manifest) -> bytes:
    """Encode a manifest."""
    body = _MANIFEST.dump_python(manifest, mode="json")
    return encode_document(body, schema=MANIFEST_SCHEMA, version=MANIFEST_VERSION)


def decode_manifest(data: bytes, source: str) -> Manifest:
    """Return the manifest in a document, which messages call ``source``; raise as :func:`decode_document`."""
    body = decode_document(data, schema=MANIFEST_SCHEMA, version=MANIFEST_VERSION, source=source)
    try:
        return _MANIFEST.validate_python(body)
    except ValidationError as error:
        raise DamagedArtifact(f"{source}: expected a manifest's fields: {error}") from None
