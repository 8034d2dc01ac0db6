"""The contract of a stage: what it reads, which work there is, what one piece computes, and what came of it all.

To add a stage, write a module in pipeline/stages/ that defines a :class:`Stage`, and name it in
pipeline/stages/__init__.py. The middleware (study.py and dispatch.py) does the rest: it finds what is done, spreads the
missing pieces over the cluster, keeps their results and mirrors them to MLflow.

A stage's work is a set of *chains*: pieces that follow one another, such as the segments of an evolutionary trial.
Chains do not depend on one another. A piece is an :class:`Item`; its key is the SHA-256 of what it is, so that a piece
is done if and only if the store holds its key.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.store.encoding import Json, key_of
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store

Spec = Mapping[str, Any]
"""Plain JSON values by name."""

Files = Mapping[str, bytes]
"""An item's results: contents by file name."""


NOT_POSSIBLE = "not possible: "
"""How the reason begins where a chain was never tried, since what it needs was set aside."""


class MissingInputs(PuddleError):  # noqa: N818 (what is the case, not what went wrong)
    """A piece of work needs results that are not there; says which, and how to get them."""


@dataclass(frozen=True)
class Chain:
    """Pieces of work that follow one another."""

    label: str
    """What a person calls it; unique in its stage."""
    units: tuple[float, ...]
    """Size of each piece, in the stage's unit."""
    spec: Spec
    """What tells this chain from the others of its stage."""
    weight: float = 1.0
    """Cost of a unit relative to the stage's other chains, for the order of work and the time left."""
    world: str = ""
    """Where it happens: pieces of chains of one world that are equally far and equally long may go side by side."""
    batch_size: int = 1
    """How many do so best."""

    @property
    def n_items(self) -> int:
        """How many pieces there are."""
        return len(self.units)


@dataclass(frozen=True)
class Input:
    """Files of an earlier item that a piece of work reads."""

    manifest: Manifest
    files: tuple[str, ...]


@dataclass(frozen=True)
class Job:
    """What a worker is told of a piece of work, its inputs apart."""

    key: str
    """The item's; its tables name it as their producer."""
    spec: Spec
    execution: Spec


@dataclass(frozen=True)
class Item:
    """One piece of work: a pure function of its specification and its inputs' bytes."""

    stage: str
    version: int
    label: str
    spec: Spec
    """All that changes the result, inputs apart: settings used, seed, what it is. It holds its chain's."""
    inputs: Mapping[str, Input]
    execution: Spec = field(default_factory=dict)
    """What does not change the result: engine, size of batches, ``n_gpus`` that it occupies."""

    @cached_property
    def identity(self) -> Mapping[str, Json]:
        """What the key stands for."""
        inputs = {name: source.manifest.digest for name, source in self.inputs.items()}
        return {"stage": self.stage, "version": self.version, "spec": self.spec, "inputs": inputs}

    @cached_property
    def key(self) -> str:
        """The SHA-256 of the identity."""
        return key_of(self.identity)

    @property
    def job(self) -> Job:
        """What its worker is told."""
        return Job(key=self.key, spec=self.spec, execution=self.execution)


@dataclass(frozen=True)
class Results:
    """What the store holds of a stage for one study."""

    stage: str
    done: Mapping[str, tuple[Manifest, ...]]
    """Manifests of every chain that is complete, by label."""
    failed: Mapping[str, str] = field(default_factory=dict)
    """Why, for every chain that failed, by label."""
    unfinished: tuple[str, ...] = ()
    """Labels of the chains that have pieces still to do."""
    n_done: Mapping[str, int] = field(default_factory=dict)
    """Pieces done of every chain, by label."""
    seconds: float = 0.0
    """Core-seconds that the pieces done took, on whatever machine made them."""
    diverged: Mapping[str, str] = field(default_factory=dict)
    """What diverged in chains that are complete, by label; the driver looks for it."""

    def chain(self, label: str) -> tuple[Manifest, ...]:
        """Give the manifests of a chain.

        Raises:
            MissingInputs: the chain is not complete; says why.
        """
        if label not in self.done:
            raise MissingInputs(f"{self.stage} of {label} is {self.failed.get(label, 'not done')}")
        return self.done[label]


Upstream = Mapping[str, Results]
"""Results of earlier stages, by name."""


@dataclass(frozen=True)
class TrialSummary:
    """One trial, as MLflow shows it."""

    name: str
    params: Mapping[str, str | int | float]
    metrics: Mapping[str, float]
    curves: Mapping[str, npt.NDArray[np.float64]]
    """Metrics by generation."""
    steps: Sequence[int] | None = None
    """Of the curves' points, where they are not 0, 1, 2 …"""


@dataclass(frozen=True)
class Summary:
    """What came of a stage."""

    lines: Sequence[str]
    """For the terminal."""
    metrics: Mapping[str, float] = field(default_factory=dict)
    trials: Sequence[TrialSummary] = ()
    artifacts: Mapping[str, bytes] = field(default_factory=dict)
    """Files that a person may want to open, by path."""
    of_study: bool = False
    """Whether the study as a whole shows these metrics and artifacts too, so that studies can be compared by them."""


@dataclass(frozen=True)
class Stage:
    """All work of one kind."""

    name: str
    version: int
    """Raised when the same specification would give other results than before."""
    unit: str
    """What its work is counted in."""
    reads: Callable[[Settings], tuple[str, ...]]
    """Stages whose results it needs under these settings."""
    plan: Callable[[Settings], Sequence[Chain]]
    item: Callable[[Settings, Chain, int, Manifest | None, Upstream], Item]
    """Specify a chain's next piece from the one before it (None at the chain's start) and the stages it reads."""
    compute: Callable[[Job, Mapping[str, Files]], Files]
    """Compute a piece from what it is and its inputs' files, by name. Runs on a worker: no store, no clock."""
    summarise: Callable[[Settings, Results, Store], Summary]
    compute_batch: Callable[[Sequence[Job], Sequence[Mapping[str, Files]]], Sequence[Files]] | None = None
    """Compute pieces of chains that may go side by side, as one call: what ``compute`` makes of each, but sooner."""
    diverged: Callable[[Settings, Results, Store], Mapping[str, str]] = lambda settings, results, store: {}
    """What diverged in its chains that are complete, by label; none of them where all stayed finite."""
