"""The contract of a stage: what it reads, what work there is, what one item computes, and how to sum it up.

To add a stage, write a module in pipeline/stages/ that exports a :class:`Stage`, and add it to the list in
pipeline/stages/__init__.py. The workflow does the rest: it finds what is done, spreads the missing items over the
cluster, commits their results and mirrors them to MLflow.

A stage's work is a set of independent *chains*. A chain is a sequence of items, such as the segments of an evolutionary
trial. An :class:`Item` is done if and only if the store holds its key, the SHA-256 of its identity.
"""

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, TypeAlias, TypeVar

from pydantic_core import to_jsonable_python

from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.mlflow.run import CurvePoints
from pipeline.store.encoding import Json, digest, key_of
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.identity import ChainId, InputName, TrialId
from tasks.simulation.engine import EngineName

ChainSpecT = TypeVar("ChainSpecT")
ItemSpecT = TypeVar("ItemSpecT")

Files = Mapping[str, bytes]  # an item's results: contents by file name


@dataclass(frozen=True)
class StoredFiles(Mapping[str, bytes]):
    """The files of an item that a store has, each read when it is asked for."""

    store: Store
    manifest: Manifest

    def __getitem__(self, name: str) -> bytes:
        if name not in self.manifest.files:
            raise KeyError(name)
        return self.store.read(self.manifest, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self.manifest.files)

    def __len__(self) -> int:
        return len(self.manifest.files)


Inputs = Mapping[InputName, Files]  # contents of an item's inputs, in the order in which the item lists them


class MissingInputs(PuddleError):  # noqa: N818 (a state, not a fault)
    """An item needs results that are not there; the message says which, and how to get them."""


@dataclass(frozen=True)
class Failure:
    """Why a chain can't go on."""

    reason: str
    tried: bool = True  # whether its next item was tried; False where an input of the item failed

    def __str__(self) -> str:
        return self.reason if self.tried else f"not possible: {self.reason}"


@dataclass(frozen=True)
class Execution:
    """Execution options: how an item is computed. They never change its result."""

    engine: EngineName = "batch"
    designs_per_batch: int | None = None  # that one worker simulates at a time; None for all on the item's own worker
    n_gpus: int = 0


@dataclass(frozen=True)
class Chain(Generic[ChainSpecT]):
    """Items that follow one another."""

    identity: ChainId
    units: tuple[float, ...]  # size of each item, in the stage's unit
    spec: ChainSpecT  # what all its items have in common: each item's specification is this one, or has it as a field
    weight: float = 1.0  # about what a unit takes on a core [s], for the order of work, the time left and forecasts
    batch_key: Hashable = None  # chains with the same key, equally far and equally long, may form a batch
    batch_size: int = 1  # chains that make the fastest batch
    one_gpu: bool = False  # whether that batch is the work of one GPU, rather than of one core of several

    @property
    def label(self) -> str:
        """Name for display."""
        return self.identity.label

    @property
    def n_items(self) -> int:
        """Number of items."""
        return len(self.units)


@dataclass(frozen=True)
class Input:
    """Files of an earlier item."""

    manifest: Manifest
    files: tuple[str, ...]

    @property
    def digest(self) -> str:
        """What enters the key of an item that reads it."""
        return self.manifest.digest

    def read(self, store: Store) -> Files:
        """Return the contents by file name."""
        return {name: store.read(self.manifest, name) for name in self.files}


@dataclass(frozen=True)
class OutsideFile:
    """A user's file, from outside the store. The driver reads it when it submits the item."""

    path: str
    digest: str  # SHA-256 of its content, which alone enters the item's key

    def read(self, _store: Store | None = None) -> Files:
        """Return the content by the file's path.

        Raises:
            PuddleError: it has changed.
        """
        path = Path(self.path)
        content = path.read_bytes()
        if (found := digest(content)) != self.digest:
            raise PuddleError(
                f"{path}: expected the file with the SHA-256 {self.digest[:12]}…, got {found[:12]}…: it has changed "
                f"since the study was recorded. Name it again (`puddle collect --tracks`) to learn from it as it is"
            )
        return {self.path: content}


Sources: TypeAlias = dict[InputName, Input | OutsideFile]


@dataclass(frozen=True)
class Item(Generic[ItemSpecT]):
    """A work item: a pure function of its specification and its inputs' bytes."""

    stage: str
    version: int
    label: str
    spec: ItemSpecT  # everything that changes the result, besides inputs: settings, seed, trial
    inputs: Sources
    execution: Execution = Execution()

    @cached_property
    def identity(self) -> Mapping[str, Json]:
        """What the key is the hash of."""
        inputs = {name.label: source.digest for name, source in self.inputs.items()}
        return {"stage": self.stage, "version": self.version, "spec": to_jsonable_python(self.spec), "inputs": inputs}

    @cached_property
    def key(self) -> str:
        """The SHA-256 of the identity."""
        return key_of(self.identity)

    def __getstate__(self) -> dict[str, Any]:
        """Return what a worker receives; it gets the contents of the inputs beside it."""
        return {**vars(self), "key": self.key, "inputs": {}, "identity": {}}


@dataclass(frozen=True)
class Results:
    """What the store holds of a stage for one study, by chain."""

    stage: str
    done: Mapping[ChainId, tuple[Manifest, ...]] = field(repr=False)  # of every complete chain, in the plan's order
    failed: Mapping[ChainId, Failure] = field(default_factory=dict)
    unfinished: tuple[ChainId, ...] = ()  # chains that have items still to do
    n_done: Mapping[ChainId, int] = field(default_factory=dict, repr=False)  # number of items done of every chain
    seconds: float = 0.0  # core-seconds that the items took, on the machines that made them
    diverged: Mapping[ChainId, str] = field(default_factory=dict)  # in complete chains; the driver fills it in
    n_other_code: int = 0  # number of items done that a different version of the code made

    def chain(self, identity: ChainId) -> tuple[Manifest, ...]:
        """Return the manifests of a chain; raise MissingInputs, with the reason, if it is not complete."""
        if identity not in self.done:
            raise MissingInputs(f"{self.stage} of {identity.label} is {self.failed.get(identity, 'not done')}")
        return self.done[identity]


Upstream = Mapping[str, Results]  # results of earlier stages, by stage name


@dataclass(frozen=True)
class Summary:
    """The results of a stage, or of one of its chains, in short."""

    lines: Sequence[str] = ()  # lines for the terminal
    metrics: Mapping[str, float] = field(default_factory=dict)
    artifacts: Mapping[str, bytes] = field(default_factory=dict)  # files that a person may want to open, by path
    films: Mapping[TrialId, Mapping[str, bytes]] = field(default_factory=dict)  # of trials of other stages, by path
    of_study: bool = False  # whether the study as a whole shows these metrics and artifacts too, to compare studies


@dataclass(frozen=True)
class Stage(Generic[ChainSpecT, ItemSpecT]):
    """All work of one kind."""

    name: str
    version: int  # raised when the same specification would give other results than before
    unit: str  # unit of work, in the plural
    reads: Callable[[Settings], tuple[str, ...]]  # names of the stages whose results it needs under these settings
    plan: Callable[[Settings], Sequence[Chain[ChainSpecT]]]
    item: Callable[[Settings, Chain[ChainSpecT], int, Manifest | None, Upstream], Item[ItemSpecT]]
    """Specify item i of a chain from the item before it (None at the chain's start) and the stages it reads."""
    compute: Callable[[Item[ItemSpecT], Inputs], Files]  # runs on a worker: no store, no clock
    summarise: Callable[[Settings, Upstream, Store], Summary]
    compute_batch: Callable[[Sequence[Item[ItemSpecT]], Sequence[Inputs]], Sequence[Files]] | None = None
    """Compute items that form a batch in one call: the same files as ``compute`` makes of each, but faster."""
    diverged: Callable[[Settings, Upstream, Store], Mapping[ChainId, str]] = lambda settings, upstream, store: {}
    """Describe what diverged, by complete chain; chains that stayed finite are left out."""
    summarise_trial: Callable[[ChainId, Sequence[Files]], Summary] | None = None
    """Sum up a chain from the files of its items, as soon as it is complete. MLflow shows such a stage by chain."""
    curves: Callable[[Files], CurvePoints] = lambda files: CurvePoints()
    """Return the points that an item adds to the curves of its chain in MLflow."""


AnyStage: TypeAlias = Stage[Any, Any]
