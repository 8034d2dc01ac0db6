"""A kit's folder, which is never written over anything but another kit."""

from collections.abc import Mapping
from pathlib import Path

from pipeline.store.encoding import Json
from pipeline.store.owned_folder import FolderKind

KIT_MANIFEST = "kit.json"  # makes a folder a kit: schema, source, findings and the SHA-256 of every other file
KIT = FolderKind("a kit", "puddle.kit", 1, KIT_MANIFEST)


def write_kit(folder: Path, files: Mapping[str, bytes], manifest: Mapping[str, Json]) -> list[str]:
    """Write a kit.

    Args:
        folder: Folder of the kit.
        files: Contents by name.
        manifest: Content of the manifest, without the digests of the files.

    Returns:
        A line per file of the user that was preserved.
    """
    with KIT.replace(folder, manifest) as new:
        for name, content in files.items():
            new.write(name, content)
    return new.preserved
