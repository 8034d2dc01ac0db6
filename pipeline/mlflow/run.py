"""What is mirrored: runs and their curves, as plain values."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal


@dataclass(frozen=True)
class CurvePoints:
    """Points of some curves, such as those of one segment of a trial."""

    steps: Sequence[int] = ()  # generations or iterations
    values: Mapping[str, Iterable[float]] = field(default_factory=dict)  # by name of the curve, one for each step


@dataclass(frozen=True)
class CurvePart:
    """The points that one work item adds to a run's curves. They are read only if MLflow lacks them."""

    digest: str  # of the item
    read: Callable[[], CurvePoints]


@dataclass(frozen=True)
class Run:
    """A run in MLflow: a study, one of its stages, or a trial of a stage."""

    name: str
    key: str  # identity, unique among its siblings
    params: Mapping[str, Any] = field(default_factory=dict)  # settings used; nested mappings become dotted names
    metrics: Mapping[str, float] = field(default_factory=dict)  # MLflow cannot store infinities and NaN
    curves: Sequence[CurvePart] = ()  # metrics by generation
    tags: Mapping[str, str] = field(default_factory=dict)  # further text to search by
    note: str = ""  # description in Markdown, with {artifacts} for the address of the run's
    artifacts: Mapping[str, bytes] = field(default_factory=dict)  # files to open from the UI, by path
    status: Literal["FINISHED", "FAILED"] | None = None
    """None for a run that has not ended; MLflow keeps the status of one that has."""
