"""A simulated disk that can lose power at any of the six effects of pipeline/store/disk.py.

Two faults are simulated. A process that dies loses nothing that it has written. A power cut loses what was not synced:
POSIX guarantees the content of a file at its last fsync, and the list of names of a folder at the folder's last fsync.
Of everything since, any part may be there or missing, in any order. This module keeps account of both, and writes the
disk as it could be found after the cut.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

EFFECTS = ("write", "fsync", "rename", "mkdir", "unlink", "rmdir")
DEAD = 9
"""Exit code of a child that a fault has ended."""


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
    """The distinct disks that all faults of one run would leave, collected without any of them happening."""

    def __init__(
        self, account: Account, committed: list[str], kinds: list[str], seed: int, points: list[int] | None
    ) -> None:
        self._account, self._committed, self._kinds, self._seed = account, committed, kinds, seed
        self._points = points
        self._number: dict[frozenset[tuple[str, bytes | None]], int] = {}
        self.disks: list[Image] = []
        self.described: list[dict[str, Any]] = []
        """For each disk, the faults that leave it and the items committed before the last of them."""

    def observe(self, at: int, effect: str, path: Path, *rest: Any) -> None:
        """Collect the disks that faults before this effect would leave."""
        if self._points is not None and at not in self._points:
            return
        for kind in self._kinds:
            loses = "none" if kind in ("die", "tear") else kind
            image = self._account.image(loses, random.Random(self._seed + at))
            if kind == "tear":
                if effect != "write":
                    continue
                image[self._account.name(path)] = rest[0][: len(rest[0]) // 2]
            number = self._number.setdefault(frozenset(image.items()), len(self.disks))
            if number == len(self.disks):
                self.disks.append(image)
                self.described.append({"faults": []})
            self.described[number]["faults"].append([kind, at])
            self.described[number]["committed"] = list(self._committed)


# -- the seam --------------------------------------------------------------------------------------------------------


@dataclass
class _State:
    effects: list[str] = field(default_factory=list)
    fault: dict[str, Any] | None = None
    account: Account | None = None
    survey: Survey | None = None
    die: Callable[[], None] = lambda: None


_state = _State()


def watch(disk: ModuleType) -> None:
    """Insert this module between the store and the six effects."""
    for name in EFFECTS:
        setattr(disk, name, _guard(name, getattr(disk, name)))


def at_death(die: Callable[[], None]) -> None:
    """Set what ends a process that a fault strikes; it must not return."""
    _state.die = die


def arm(fault: dict[str, Any] | None, top: Path) -> None:
    """Reset the count of effects, and strike before effect number ``fault["at"]`` if there is a fault.

    ``fault["kind"]`` is die; tear, where a write stops half-way; or power, where the disk after the cut is written to
    ``fault["image"]`` without what ``fault["loses"]`` names.
    """
    _state.effects, _state.fault, _state.account, _state.survey = [], fault, None, None
    if fault and fault["kind"] == "power":
        _state.account = Account(top)


def survey(top: Path, committed: list[str], kinds: list[str], seed: int, points: list[int] | None = None) -> Survey:
    """Collect, from :func:`arm` on, the disks that faults would leave of a folder.

    Args:
        top: the folder.
        committed: keys of the committed items, a list that grows.
        kinds: faults to consider: die, tear, or what a power cut loses.
        seed: seed for what a power cut loses at random.
        points: numbers of the effects before which faults are considered; all of them if None.

    Returns:
        The survey, which is complete when the run is.
    """
    _state.account = Account(top)
    _state.survey = Survey(_state.account, committed, kinds, seed, points)
    return _state.survey


def stop_survey() -> None:
    """End the survey."""
    _state.survey = None


def effects() -> list[str]:
    """List the effects since :func:`arm`."""
    return _state.effects


def strike() -> None:
    """Let the fault happen."""
    fault, account = _state.fault, _state.account
    if fault is not None and account is not None and fault["kind"] == "power":
        write_image(account.image(fault["loses"], random.Random(fault.get("seed", 0))), Path(fault["image"]))
    _state.die()


def _guard(name: str, effect: Callable[..., None]) -> Callable[..., None]:
    def guarded(path: Path, *rest: Any) -> None:
        fault = _state.fault
        if fault is not None and len(_state.effects) == fault["at"]:
            if fault["kind"] == "tear":
                if name != "write":
                    raise AssertionError(f"effect {fault['at']} is a {name}, expected a write")
                effect(path, rest[0][: len(rest[0]) // 2])
            strike()
        if _state.survey is not None:
            _state.survey.observe(len(_state.effects), name, path, *rest)
        _state.effects.append(name)
        effect(path, *rest)
        if _state.account is not None:
            _state.account.record(name, path, *rest)

    return guarded
