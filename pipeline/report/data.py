"""What the page needs to know of a study, as plain frozen data, and the sums over trials that it shows.

Nothing is required to be there: a study that has only begun, or that lost some of its trials, still makes a report.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from pipeline.config.settings import EnvironmentName
from pipeline.report.findings import Findings
from pipeline.report.replay import Replay
from tasks.analysis.uncertainty import RESOLUTION

Quantity = Literal["predicted", "zero_shot", "zero_shot_com", "adapted", "adapted_com"]
"""What is measured of a champion [m]."""


@dataclass(frozen=True)
class EnvironmentStyle:
    """How an environment is named and drawn; the colours are those of the paper's Fig. 4."""

    label: str
    symbol: str
    """The paper's."""
    color: str
    adapted_color: str
    """Of the same arm once its controllers have adapted to True Slush; drawn hatched."""
    marker: str
    """So that colour is never the only difference."""
    evolved: str
    """Where a robot evolved, in a sentence."""


ENVIRONMENTS: Mapping[EnvironmentName, EnvironmentStyle] = {
    "true_slush": EnvironmentStyle("True Slush", "E", "#1c6fb8", "#a6cbe8", "o", "in True Slush"),
    "dry_land": EnvironmentStyle("Dry Land", "E′", "#1d6b3c", "#9ed3a9", "s", "on Dry Land"),
    "residual_slush": EnvironmentStyle("Residual Slush", "Ê", "#dd7700", "#fbcb8f", "^", "in Residual Slush"),
    "single_member": EnvironmentStyle("Single member", "Ê₁", "#7d4aa5", "#cfb6e2", "D", "with a single member"),
}
"""In the order in which they are listed everywhere."""

PAPER_DEPTH = 9.0
"""Depth at which the paper states its numbers [m]."""

PAPER_TRUE_SLUSH = 13.6
"""Mean displacement of designs evolved in True Slush, at 9 m [m]. Paper, "Evolution"."""

PAPER: Mapping[tuple[EnvironmentName, Quantity], float] = {
    ("true_slush", "predicted"): PAPER_TRUE_SLUSH,
    ("true_slush", "zero_shot"): PAPER_TRUE_SLUSH,
    ("dry_land", "zero_shot"): -0.8,
    ("dry_land", "adapted"): 4.8,
    ("residual_slush", "zero_shot"): 0.67 * PAPER_TRUE_SLUSH,
    ("residual_slush", "adapted"): 0.87 * PAPER_TRUE_SLUSH,
}
"""Means over 10 trials that the paper states at 9 m [m]; for Residual Slush it states the share of E, 67 and 87 %."""


@dataclass(frozen=True, eq=False)
class TrialResult:
    """One trial's champion and how it fared [m]; NaN where its rollout diverged."""

    environment: EnvironmentName
    """Where it evolved."""
    depth: float
    """[m]"""
    trial: int
    predicted: float
    """Fitness in the world where it evolved (in Residual Slush the mean of its members less k deviations)."""
    zero_shot: float | None = None
    """Displacement of its root in True Slush; None before it has been there."""
    zero_shot_com: float | None = None
    """The same of the whole robot's centre of mass."""
    adapted: float | None = None
    """Displacement of its root in True Slush with a controller that evolved there; None before that."""
    adapted_com: float | None = None
    """The same of the whole robot's centre of mass."""
    curve: npt.NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    """(n_generations,) best fitness so far in the world where it evolves [m]."""


@dataclass(frozen=True)
class ResidualError:
    """How well one member predicts one component of the residual, over held-out transitions in one band of speed."""

    member: int
    component: str
    """Such as "vx"."""
    unit: str
    """Of ``rmse`` and ``rms_residual``, such as "m/s"."""
    speed_band: str
    """Such as "0.5-2 m/s"; bands are shown in the order in which they first appear."""
    rmse: float
    """Root mean square of prediction less residual."""
    rms_residual: float
    """Root mean square of the residual itself: the error of one who predicts nothing. 0 where it is not known."""


@dataclass(frozen=True)
class Draws:
    """How often an operator of evolution drew designs, and how many of them the morphology refused."""

    operator: str
    n_drawn: int
    n_rejected: int


@dataclass(frozen=True)
class Digest:
    """An artifact of the study and its SHA-256."""

    stage: str
    label: str
    sha256: str


@dataclass(frozen=True, eq=False)
class StudyReport:
    """A study, or as much of it as there is."""

    name: str
    title: str
    created_with: Mapping[str, str]
    """What -> version."""
    settings_yaml: str
    trials: Sequence[TrialResult] = ()
    residual_errors: Sequence[ResidualError] = ()
    replays: Sequence[Replay] = ()
    findings: Findings = field(default_factory=Findings)
    draws: Sequence[Draws] = ()
    """Of each operator that drew again; none where any body would do."""
    measured_seconds: float = 20.0
    """How long robots' way is measured [s]. [P]"""
    digests: Sequence[Digest] = ()
    failed: Sequence[str] = ()
    """Work that failed twice, named."""
    not_possible: Sequence[str] = ()
    """Work that needs some of that, named."""
    diverged: Sequence[str] = ()
    """Trials some of whose designs diverged, or all, named."""


@dataclass(frozen=True)
class Estimate:
    """A quantity over trials."""

    mean: float
    """[m]"""
    sd: float | None
    """Sample standard deviation [m]; None with a single trial."""
    values: tuple[float, ...]
    """One per trial, in the trials' order [m]."""

    @property
    def n(self) -> int:
        """Trials with a finite value."""
        return len(self.values)


def estimate(trials: Iterable[TrialResult], quantity: Quantity) -> Estimate | None:
    """Take the mean and deviation of a quantity over trials that have it; None where no trial has."""
    values = [value for trial in trials if (value := getattr(trial, quantity)) is not None and np.isfinite(value)]
    if not values:
        return None
    return Estimate(
        mean=float(np.mean(values)),
        sd=float(np.std(values, ddof=1)) if len(values) > 1 else None,
        values=tuple(float(value) for value in values),
    )


def all_diverged(trials: Sequence[TrialResult]) -> bool:
    """Tell whether trials have run, and no design of any of them stayed finite."""
    return bool(trials) and all(len(trial.curve) > 0 and not np.isfinite(trial.curve).any() for trial in trials)


ALL_DIVERGED = "every design of every trial diverged"
"""Why there is then nothing to show of champions."""


def depths(trials: Iterable[TrialResult]) -> list[float]:
    """List the depths that trials were made at [m], shallowest first."""
    return sorted({trial.depth for trial in trials})


def deepest_scored(trials: Iterable[TrialResult]) -> float | None:
    """Find the greatest depth at which a champion went to True Slush as it was [m]; None where none has."""
    scored = [trial.depth for trial in trials if trial.zero_shot is not None and np.isfinite(trial.zero_shot)]
    return max(scored, default=None)


def arm(trials: Iterable[TrialResult], environment: EnvironmentName, depth: float) -> list[TrialResult]:
    """Choose the trials of one environment and depth, in the order of their numbers."""
    chosen = [trial for trial in trials if trial.environment == environment and trial.depth == depth]
    return sorted(chosen, key=lambda trial: trial.trial)


def environments(trials: Iterable[TrialResult]) -> list[EnvironmentName]:
    """List the environments that designs evolved in, in their usual order."""
    present = {trial.environment for trial in trials}
    return [environment for environment in ENVIRONMENTS if environment in present]


def ratio(part: Estimate | None, whole: Estimate | None) -> float | None:
    """Say what share of one mean another is; None where there is none to compare with, or it went nowhere."""
    if part is None or whole is None or whole.mean <= RESOLUTION:
        return None
    return part.mean / whole.mean
