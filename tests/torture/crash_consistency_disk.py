"""A simulated disk that can lose power at any of the six effects of pipeline/store/disk.py.

Two faults are simulated. A process that dies loses nothing that it has written. A power cut loses what was not synced:
POSIX guarantees the content of a file at its last fsync, and the list of names of a folder at the folder's last fsync.
Of everything since, any part may be there or missing, in any order. This module keeps account of both, and writes the
disk as it could be found after the cut.
"""

from __future__ import annotations

import contextlib
import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from pipeline.store import disk

EFFECTS = ("write", "fsync", "rename", "mkdir", "unlink", "rmdir")


@dataclass
class File:
    """Contents of a file since its last fsync; the first one is safe."""

    contents: list[bytes] = field(default_factory=lambda: [b""])


@dataclass
class Folder:
    """Lists of a folder's names since its last fsync; the first one is safe."""

    names: list[dict[str, File | Folder]] = field(default_factory=lambda: [{}])

    @property
    def now(self) -> dict[str, File | Folder]:
        return self.names[-1]

    def change(self, name: str, to: File | Folder | None) -> None:
        changed = {**self.now, name: to}
        self.names.append({known: node for known, node in changed.items() if node is not None})


class Account:
    """What was done to a folder, and which part of it is safe."""

    def __init__(self, top: Path) -> None:
        self._top = top
        self._folder = self._read(top)

    def _read(self, path: Path) -> File | Folder:
        """Read what exists already; all of it is safe."""
        if not path.is_dir():
            return File([path.read_bytes()])
        return Folder([{inner.name: self._read(inner) for inner in path.iterdir() if inner.suffix != ".lock"}])

    def _at(self, path: Path) -> Any:
        node: Any = self._folder
        for name in path.relative_to(self._top).parts:
            node = node.now[name]
        return node

    def name(self, path: Path) -> str:
        """Return a path as images name it."""
        return f"/{path.relative_to(self._top)}"

    def record(self, effect: str, path: Path, *rest: Any) -> None:
        """Record an effect that has happened."""
        if not path.is_relative_to(self._top):
            return
        folder = self._at(path.parent) if path != self._top else None
        match effect:
            case "write":
                if path.name not in folder.now:
                    folder.change(path.name, File())
                folder.now[path.name].contents.append(rest[0])
            case "fsync":
                node = self._at(path)
                history = node.contents if isinstance(node, File) else node.names
                del history[:-1]
            case "rename":
                node = folder.now[path.name]
                folder.change(path.name, None)
                self._at(rest[0].parent).change(rest[0].name, node)
            case "mkdir":
                if path.name not in folder.now:
                    folder.change(path.name, Folder())
            case "unlink" | "rmdir":
                folder.change(path.name, None)

    def image(self, loses: str, chance: random.Random) -> Image:
        """Return the disk after a power cut.

        Args:
            loses: the part of the unsynced data that is lost: all, contents, names, some (at random) or none.
            chance: generator that decides what "some" means.
        """
        found: Image = {}
        self._collect(self._folder, "", loses, chance, found)
        return found

    def _collect(self, node: File | Folder, path: str, loses: str, chance: random.Random, found: Image) -> None:
        if isinstance(node, Folder):
            found[path] = None
            names = {"all": node.names[0], "names": node.names[0], "contents": node.now, "none": node.now}.get(loses)
            for name, inner in (chance.choice(node.names) if names is None else names).items():
                self._collect(inner, f"{path}/{name}", loses, chance, found)
            return
        safe, last = node.contents[0], node.contents[-1]
        zeros = safe if safe == last else bytes(len(last))  # the length was written, its blocks were not
        some = chance.choice([safe, last, zeros, last[: chance.randrange(len(last) + 1)]]) if safe != last else last
        found[path] = {"all": safe, "contents": zeros, "names": last, "none": last}.get(loses, some)


Image = dict[str, bytes | None]
"""Content of every file on a disk by its path, None for a folder; the empty path is the disk itself."""


def write_image(image: Image, target: Path) -> None:
    """Write an image into a folder."""
    for path, data in image.items():
        if data is None:
            (target / path.lstrip("/")).mkdir()
        else:
            (target / path.lstrip("/")).write_bytes(data)


class Survey:
    """The distinct disks that faults would leave at every point of one run, without any of them happening."""

    def __init__(self, top: Path, committed: list[str], kinds: Sequence[str], seed: int) -> None:
        self._account, self._committed, self._kinds, self._seed = Account(top), committed, kinds, seed
        self._number: dict[frozenset[tuple[str, bytes | None]], int] = {}
        self.effects: list[str] = []
        self.disks: list[Image] = []
        self.n_faults = 0
        self.committed: list[list[str]] = []
        """For each disk, the items that were committed before the last fault that leaves it."""

    def _observe(self, effect: str, path: Path, *rest: Any) -> None:
        """Collect the disks that faults before this effect would leave."""
        for kind in self._kinds:
            loses = "none" if kind in ("die", "tear") else kind
            image = self._account.image(loses, random.Random(self._seed + len(self.effects)))
            if kind == "tear":
                if effect != "write":
                    continue
                image[self._account.name(path)] = rest[0][: len(rest[0]) // 2]
            self.n_faults += 1
            number = self._number.setdefault(frozenset(image.items()), len(self.disks))
            if number == len(self.disks):
                self.disks.append(image)
                self.committed.append([])
            self.committed[number] = list(self._committed)

    def watch(self, name: str, effect: Callable[..., None]) -> Callable[..., None]:
        """Return an effect that is observed, happens, and is accounted for."""

        def watched(path: Path, *rest: Any) -> None:
            self._observe(name, path, *rest)
            self.effects.append(name)
            effect(path, *rest)
            self._account.record(name, path, *rest)

        return watched


@contextlib.contextmanager
def survey(top: Path, kinds: Sequence[str], seed: int, committed: list[str] | None = None) -> Iterator[Survey]:
    """Survey what runs meanwhile.

    Args:
        top: the folder whose disk it is.
        kinds: faults to consider: die, tear, or what a power cut loses.
        seed: seed for what a power cut loses at random.
        committed: keys of the committed items, a list that grows.
    """
    found = Survey(top, [] if committed is None else committed, kinds, seed)
    with pytest.MonkeyPatch.context() as patch:
        for name in EFFECTS:
            patch.setattr(disk, name, found.watch(name, getattr(disk, name)))
        yield found
