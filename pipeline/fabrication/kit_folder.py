"""A kit's folder: written whole under its name, or not at all; and never over anything but another kit."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from pipeline.errors import PuddleError
from pipeline.store import disk
from pipeline.store.encoding import Json, check_format, decode_json, encode_json

_SCHEMA, _VERSION = "puddle.kit", 1
KIT_MANIFEST = "kit.json"
"""What makes a folder a kit: its schema, what it is of, and the SHA-256 of every other file."""


def check_place(folder: Path) -> Path:
    """Refuse a place that holds anything but a kit.

    Returns:
        The place as an absolute path, without links and dots.

    Raises:
        PuddleError: says what is there.
    """
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise PuddleError(f"{folder}: expected a new folder or a kit, came a file or a link. Choose another: --out")
    place = folder.resolve()
    if not folder.exists():
        if not folder.parent.is_dir():
            raise PuddleError(f"{folder}: expected a place in a folder that exists; {folder.parent} does not")
        return place
    if Path.cwd().is_relative_to(place):  # it is replaced as a whole, and a shell would stay behind in the old one
        raise PuddleError(f"{folder}: expected a folder other than the one that you are in. Choose another: --out")
    names = sorted(path.name for path in folder.iterdir())
    if not names:
        return place
    if KIT_MANIFEST not in names:
        raise PuddleError(
            f"{folder}: expected a new folder or a kit, found {', '.join(names[:3])} and no {KIT_MANIFEST}. "
            f"Choose another: --out"
        )
    check_format(
        decode_json(disk.read(folder / KIT_MANIFEST), str(folder / KIT_MANIFEST)),
        schema=_SCHEMA,
        version=_VERSION,
        source=str(folder / KIT_MANIFEST),
    )
    return place


def write_kit(folder: Path, files: Mapping[str, bytes], said: Mapping[str, Json]) -> list[str]:
    """Write a kit's files and its mark beside the place, and then put them there at once.

    Of the kit that it replaces, what the user put there (logs of drives) or changed (the calibration) is kept.

    Returns:
        What was kept, a line each.

    Raises:
        PuddleError: the place holds something else, or the disk fails; what was there before is still there.
    """
    folder = check_place(folder)
    digests = {name: hashlib.sha256(content).hexdigest() for name, content in sorted(files.items())}
    mark = encode_json({**said, "schema": _SCHEMA, "version": _VERSION, "files": digests})
    new = folder.with_name(f".{folder.name}.{os.getpid()}.new")
    old = folder.with_name(f".{folder.name}.{os.getpid()}.old")
    with disk.explained("writing the kit", folder, advice="give the same command again"):
        yours, lines = _yours(folder, files)
        try:
            for name, content in {**yours, **files, KIT_MANIFEST: mark}.items():
                path = new / name
                path.parent.mkdir(parents=True, exist_ok=True)
                disk.write(path, content)
                disk.fsync(path)
            if folder.exists():
                disk.rename(folder, old)
            disk.rename(new, folder)
            disk.fsync(folder.parent)
        except BaseException:  # Ctrl-C too: what the user put there is in no other place
            if old.exists():
                if folder.exists():
                    disk.rename(folder, new)
                disk.rename(old, folder)
            raise
        finally:
            shutil.rmtree(new, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)
    return lines


def _yours(folder: Path, files: Mapping[str, bytes]) -> tuple[dict[str, bytes], list[str]]:
    """Read what a kit's folder holds beside the kit as it was made, under the names that it will have."""
    if not (folder / KIT_MANIFEST).is_file():
        return {}, []
    mark = decode_json(disk.read(folder / KIT_MANIFEST), str(folder / KIT_MANIFEST))
    made = mark["files"] if isinstance(mark.get("files"), dict) else {}
    yours: dict[str, bytes] = {}
    lines = []
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if name == KIT_MANIFEST or path.is_symlink() or not path.is_file():
            continue
        content = path.read_bytes()
        if made.get(name) == hashlib.sha256(content).hexdigest() or files.get(name) == content:
            continue
        kept, number = name, 0
        while kept in files or kept in yours:
            number += 1
            kept = path.with_stem(f"{path.stem}-yours-{number}").relative_to(folder).as_posix()
        yours[kept] = content
        lines.append(f"Kept {name}{'' if kept == name else f', which you had changed, as {kept}'}.")
    return yours, lines
