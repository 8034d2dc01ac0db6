"""A disk that can be cut off: the six effects of pipeline/store/disk.py, struck at any one of them.

Besides the death of the process, which loses nothing that was written, there is the loss of power, which loses what was
not synced. POSIX promises of a file's content what its last fsync saw, and of a folder's list of names what the
folder's last fsync saw; of anything since, some may be there and some not, in any order. This module keeps account of
both, and lays out a disk as it could be found after the cut.
"""

from __future__ import annotations

import pickle
import random
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

EFFECTS = ("write", "fsync", "rename", "mkdir", "unlink", "rmdir")
DEAD = 9
"""Exit code of a child that was struck."""


@dataclass
class File:
    """A file's contents since its last fsync; the first is what is safe."""

    contents: list[bytes] = field(default_factory=lambda: [b""])


@dataclass
class Folder:
    """A folder's lists of names since its last fsync; the first is what is safe."""

    names: list[dict[str, File | Folder]] = field(default_factory=lambda: [{}])

    @property
    def now(self) -> dict[str, File | Folder]:
        return self.names[-1]

    def change(self, name: str, to: File | Folder | None) -> None:
        changed = {**self.now, name: to}
        self.names.append({known: node for known, node in changed.items() if node is not None})


class Account:
    """What was done to a folder, and what of it is safe."""

    def __init__(self, top: Path) -> None:
        self._top = top
        self._folder = self._found(top)

    def _found(self, path: Path) -> File | Folder:
        """Take what is there already as safe."""
        if not path.is_dir():
            return File([path.read_bytes()])
        return Folder([{inner.name: self._found(inner) for inner in path.iterdir() if inner.suffix != ".lock"}])

    def _at(self, path: Path) -> Any:
        node: Any = self._folder
        for name in path.relative_to(self._top).parts:
            node = node.now[name]
        return node

    def name(self, path: Path) -> str:
        """Give a path as images have it."""
        return f"/{path.relative_to(self._top)}"

    def note(self, effect: str, path: Path, *rest: Any) -> None:
        """Take down an effect that has happened."""
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
        """Say what is found on the disk after the cut: ``loses`` is all, contents, names, some (by chance) or none."""
        found: Image = {}
        self._find(self._folder, "", loses, chance, found)
        return found

    def _find(self, node: File | Folder, path: str, loses: str, chance: random.Random, found: Image) -> None:
        if isinstance(node, Folder):
            found[path] = None
            names = {"all": node.names[0], "names": node.names[0], "contents": node.now, "none": node.now}.get(loses)
            for name, inner in (chance.choice(node.names) if names is None else names).items():
                self._find(inner, f"{path}/{name}", loses, chance, found)
            return
        safe, last = node.contents[0], node.contents[-1]
        zeros = safe if safe == last else bytes(len(last))  # a length that was kept, of blocks that were not
        some = chance.choice([safe, last, zeros, last[: chance.randrange(len(last) + 1)]]) if safe != last else last
        found[path] = {"all": safe, "contents": zeros, "names": last, "none": last}.get(loses, some)


Image = dict[str, bytes | None]
"""What is on a disk: the content of every file by its path, None for a folder; the empty path is the disk itself."""


def lay_out(image: Image, target: Path) -> None:
    """Write a disk."""
    for path, data in image.items():
        if data is None:
            (target / path.lstrip("/")).mkdir()
        else:
            (target / path.lstrip("/")).write_bytes(data)


class Survey:
    """The different disks that all faults of one run leave, found on the way without one of them happening."""

    def __init__(self, account: Account, committed: list[str], kinds: list[str], seed: int) -> None:
        self._account, self._committed, self._kinds, self._seed = account, committed, kinds, seed
        self._number: dict[frozenset[tuple[str, bytes | None]], int] = {}
        self.disks: list[Image] = []
        self.told: list[dict[str, Any]] = []
        """Of each disk: the faults that leave it, and which items were committed before the last of them."""

    def look(self, at: int, effect: str, path: Path, *rest: Any) -> None:
        """See what faults would leave before an effect."""
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
                self.told.append({"faults": []})
            self.told[number]["faults"].append([kind, at])
            self.told[number]["committed"] = list(self._committed)


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
    """Stand between the store and the six effects."""
    for name in EFFECTS:
        setattr(disk, name, _guard(name, getattr(disk, name)))


def at_death(die: Callable[[], None]) -> None:
    """Say how a process that is struck ends; it must not return."""
    _state.die = die


def arm(fault: dict[str, Any] | None, top: Path) -> None:
    """Count effects anew, and strike before effect number ``fault["at"]``, if there is a fault.

    ``fault["kind"]`` is die; tear, where a write stops half-way; or power, where ``fault["image"]`` receives what the
    disk holds afterwards, ``fault["loses"]`` being what is gone. The account of what is safe goes from one process to
    the next by ``fault["leaves"]`` and ``fault["takes"]``.
    """
    _state.effects, _state.fault, _state.account, _state.survey = [], fault, None, None
    if fault and "takes" in fault:
        _state.account = pickle.loads(Path(fault["takes"]).read_bytes())
    elif fault and (fault["kind"] == "power" or "leaves" in fault):
        _state.account = Account(top)


def survey(top: Path, committed: list[str], kinds: list[str], seed: int) -> Survey:
    """Look, from :func:`arm` on, at what every fault would leave of a folder.

    Args:
        top: the folder.
        committed: keys of what is committed, as the list grows.
        kinds: of faults: die, tear, or what a loss of power loses.
        seed: of the chance by which it loses some.
    """
    _state.account = Account(top)
    _state.survey = Survey(_state.account, committed, kinds, seed)
    return _state.survey


def rest() -> None:
    """Look no more."""
    _state.survey = None


def effects() -> list[str]:
    """List the effects since :func:`arm`."""
    return _state.effects


def strike() -> None:
    """Let the fault happen."""
    fault, account = _state.fault, _state.account
    if fault is not None and account is not None and "leaves" in fault:
        Path(fault["leaves"]).write_bytes(pickle.dumps(account))
    if fault is not None and account is not None and fault["kind"] == "power":
        lay_out(account.image(fault["loses"], random.Random(fault.get("seed", 0))), Path(fault["image"]))
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
            _state.survey.look(len(_state.effects), name, path, *rest)
        _state.effects.append(name)
        effect(path, *rest)
        if _state.account is not None:
            _state.account.note(name, path, *rest)

    return guarded
