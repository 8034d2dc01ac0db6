"""What the analysis of a study found, as the page shows it: plain frozen data, and why some is missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from tasks.analysis import (
    Attribution,
    Contrast,
    Crossing,
    Estimate,
    EvolvedIn,
    Exploiter,
    Histograms,
    MemberError,
    Regression,
    Row,
    Tank,
    TransferMatrix,
)
from tasks.arrays import Float64


@dataclass(frozen=True, eq=False)
class ThrownPaths:
    """The throws of the data set: paper, Fig. 2."""

    length_scale: Float64
    """(n_throws,) long axis of the link [m]."""
    path: Float64
    """(n_throws, n_steps, 3) x, y [m], angle [rad]."""
    seconds: float
    """How long each lasts [s]."""


@dataclass(frozen=True, eq=False)
class Accuracy:
    """How well designs' displacement in True Slush is predicted: paper, Fig. 3."""

    depth: float
    """[m]"""
    regressions: Sequence[Regression]
    """Of every member ("member 0" and on) and every aggregate ("mean", "mean - 1 sd", "min" and on)."""
    histograms: Histograms
    """Of the members and of the mean."""


@dataclass(frozen=True)
class Suspect:
    """A design that may live off what its world imagined."""

    label: str
    """Where it evolved, depth and trial, in words."""
    exploiter: Exploiter


@dataclass(frozen=True)
class Retried:
    """A champion tried again, with its attachments moved by next to nothing; and how much of its way is reach."""

    label: str
    """Where it evolved, depth and trial, in words."""
    claimed: float | None
    """Displacement where it evolved [m]; None where it diverged."""
    loss: Estimate
    """Claimed less the mean when tried again [m]."""
    reach: float | None
    """Displacement of the root less that of the centre of mass, in True Slush [m]; None where it is not known."""


@dataclass(frozen=True)
class Candidate:
    """A champion that might be built; lengths in the simulation's metres, None where it diverged."""

    trial: int
    proposed: bool
    """Whether it is the one to build: the nearest the champions' mean in True Slush."""
    zero_shot: float | None
    """Displacement in True Slush [m]."""
    dry_land: float | None
    """Displacement on Dry Land [m]."""
    wet: Crossing
    """In the tank."""
    dry: Crossing
    """On the tank's dry floor."""


@dataclass(frozen=True)
class TankTest:
    """The champions of one arm in the tank."""

    label: str
    """Where they evolved, and the depth, in words."""
    tank: Tank
    candidates: Sequence[Candidate]


@dataclass(frozen=True)
class Ancestor:
    """A design of a champion's family, the champion included."""

    identity: int
    """Running number within the trial."""
    generation: int
    """In which it was born."""
    age: int
    """Of its genes when it was born [generations]."""
    operator: str
    """Which made it: "random", "mutation" or "crossover"."""
    parents: tuple[int, ...]
    """Identities; none of a random design."""
    fitness: float
    """Where it evolved [m]; -inf where it diverged."""
    n_genes_changed: int | None
    """Genes in which it differs from the parent that it resembles more; None of a random design."""


@dataclass(frozen=True)
class Family:
    """Everyone that a champion descends from."""

    label: str
    """The champion, in words."""
    ancestors: Sequence[Ancestor]
    """By identity, the champion last."""


@dataclass(frozen=True, eq=False)
class Findings:
    """All of it, or as much as there is."""

    throws: ThrownPaths | None = None
    accuracy: Accuracy | None = None
    against_paper: Sequence[Row] = ()
    contrasts: Sequence[Contrast] = ()
    attributions: Sequence[Attribution] = ()
    transfer_matrices: Mapping[EvolvedIn, TransferMatrix] = field(default_factory=dict)
    """By where the champions evolved."""
    suspects: Sequence[Suspect] = ()
    """The worst first."""
    retried: Sequence[Retried] = ()
    phantom_thrust: Sequence[Estimate] = ()
    """One a member [m/s²]."""
    member_errors: Sequence[MemberError] = ()
    family: Family | None = None
    tank_tests: Sequence[TankTest] = ()
    """One an arm; none where the study has no tank."""
    missing: Mapping[str, str] = field(default_factory=dict)
    """Field of this class -> why it is not here, where a stage could say so."""

    def why(self, name: str, otherwise: str) -> str:
        """Say why a field is empty."""
        return self.missing.get(name, otherwise)
