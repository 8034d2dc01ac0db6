"""A kit's folder: written completely or not at all, and never over anything but another kit."""

import hashlib
import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from pipeline.errors import PuddleError
from pipeline.store import disk
from pipeline.store.encoding import Json, check_format, decode_json, encode_json

_SCHEMA, _VERSION = "puddle.kit", 1
KIT_MANIFEST = "kit.json"  # makes a folder a kit: schema, source, findings and the SHA-256 of every other file


def check_place(folder: Path) -> Path:
    """Return the resolved path of a folder that is new, empty or a kit. Raises PuddleError for any other."""
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise PuddleError(
            f"{folder}: expected a new folder or a kit, found a file or a link. Choose another one with --out."
        )
    place = folder.resolve()
    if not folder.exists():
        if not folder.parent.is_dir():
            raise PuddleError(
                f"{folder}: {folder.parent} does not exist. Create it, or choose another folder with --out."
            )
        return place
    if Path.cwd().is_relative_to(place):  # the folder is replaced, and the shell would stay in the old one
        raise PuddleError(f"{folder}: can't replace the current directory. Choose another folder with --out.")
    names = sorted(path.name for path in folder.iterdir())
    if not names:
        return place
    if KIT_MANIFEST not in names:
        raise PuddleError(
            f"{folder}: expected a new folder or a kit, found {', '.join(names[:3])} and no {KIT_MANIFEST}. "
            f"Choose another one with --out."
        )
    source = str(folder / KIT_MANIFEST)
    check_format(decode_json(disk.read(folder / KIT_MANIFEST), source), schema=_SCHEMA, version=_VERSION, source=source)
    return place


def write_kit(folder: Path, files: Mapping[str, bytes], manifest: Mapping[str, Json]) -> list[str]:
    """Write a kit beside its folder, then rename it into place.

    Files of the replaced kit that the user added (logs) or changed (the calibration) are preserved.

    Args:
        folder: Folder of the kit.
        files: Contents by name.
        manifest: Content of the manifest, without the digests of the files.

    Returns:
        A line per preserved file.

    Raises:
        PuddleError: The folder can't be used, or the disk fails; the previous kit is still there.
    """
    folder = check_place(folder)
    digests = {name: hashlib.sha256(content).hexdigest() for name, content in sorted(files.items())}
    encoded = encode_json({**manifest, "schema": _SCHEMA, "version": _VERSION, "files": digests})
    new = folder.with_name(f".{folder.name}.{os.getpid()}.new")
    old = folder.with_name(f".{folder.name}.{os.getpid()}.old")
    with disk.explained("writing the kit", folder, advice="run the same command again to replace it"):
        preserved, lines = _user_files(folder, files)
        try:
            for name, content in {**preserved, **files, KIT_MANIFEST: encoded}.items():
                path = new / name
                path.parent.mkdir(parents=True, exist_ok=True)
                disk.write(path, content)
                disk.fsync(path)
            if folder.exists():
                disk.rename(folder, old)
            disk.rename(new, folder)
            disk.fsync(folder.parent)
        except BaseException:  # also on Ctrl-C: the user's files have no other copy
            if old.exists():
                if folder.exists():
                    disk.rename(folder, new)
                disk.rename(old, folder)
            raise
        finally:
            shutil.rmtree(new, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)
    return lines


def _user_files(folder: Path, files: Mapping[str, bytes]) -> tuple[dict[str, bytes], list[str]]:
    """Read the files that the user added or changed, under the names that they will have in the new kit."""
    if not (folder / KIT_MANIFEST).is_file():
        return {}, []
    manifest = decode_json(disk.read(folder / KIT_MANIFEST), str(folder / KIT_MANIFEST))
    digests = manifest["files"] if isinstance(manifest.get("files"), dict) else {}
    preserved: dict[str, bytes] = {}
    lines = []
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if name == KIT_MANIFEST or path.is_symlink() or not path.is_file():
            continue
        content = path.read_bytes()
        if digests.get(name) == hashlib.sha256(content).hexdigest() or files.get(name) == content:
            continue
        new_name, number = name, 0
        while new_name in files or new_name in preserved:
            number += 1
            new_name = path.with_stem(f"{path.stem}-yours-{number}").relative_to(folder).as_posix()
        preserved[new_name] = content
        lines.append(f"Preserved {name}{'' if new_name == name else f', which you had changed, as {new_name}'}.")
    return preserved, lines
