"""The input of the page, as plain frozen data, and the averages over trials that it shows.

Nothing is required: a study that has only begun, or that lost some of its trials, still makes a report.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from pipeline.report.findings import Findings
from pipeline.report.replay import Replay
from tasks.analysis import paper
from tasks.analysis.member_error import MemberError
from tasks.analysis.scores import BEST
from tasks.analysis.uncertainty import RESOLUTION
from tasks.arrays import Float64
from tasks.world import ENVIRONMENTS, EnvironmentName

Measure = Literal[
    "predicted", "predicted_sd", "fitness", "zero_shot", "zero_shot_com", "adapted", "adapted_com"
]  # columns of TrialResult [m]


def arm_words(environment: EnvironmentName, depth: float) -> str:
    """Name an arm: where its champions evolved, and the depth [m]."""
    return f"{ENVIRONMENTS[environment].label}, {depth:g} m"


MOST_EXPLOITERS = 15  # designs listed on the page; the table of the study has all
ROBOT_PREFIX = "robot-"  # start of robots' addresses


def robot_address(environment: EnvironmentName, depth: float, trial: int, identity: int = -1) -> str:
    """Return the address of a robot on the page, which is the name of its design file, too.

    Args:
        environment: where it evolved.
        depth: [m]
        trial: number of the trial.
        identity: running number within the trial; -1 for the champion.
    """
    design = "" if identity < 0 else f"-design-{identity}"
    return f"{ROBOT_PREFIX}{environment}-{depth:g}m-trial-{trial}{design}".replace(
        ".", "_"
    )  # file names hold a single dot


@dataclass(frozen=True, eq=False)
class TrialResult:
    """The champion of one trial and its displacements [m]; NaN where its rollout diverged."""

    environment: EnvironmentName  # where it evolved
    depth: float  # [m]
    trial: int
    predicted: float  # of its root where it evolved: in an ensemble the mean over members, μ
    zero_shot: float | None = None  # displacement of its root in True Slush; None if not simulated yet
    zero_shot_com: float | None = None  # displacement of its centre of mass in True Slush
    adapted: float | None = None  # of its root with a controller that evolved there; None if not adapted
    adapted_com: float | None = None  # displacement of its centre of mass, likewise
    curve: Float64 = field(default_factory=lambda: np.empty(0))  # (n_generations,) best fitness so far [m]
    predicted_sd: float | None = None  # standard deviation over members, σ; None without an ensemble
    fitness: float | None = None  # where it evolved: in an ensemble μ - kσ

    @property
    def all_diverged(self) -> bool:
        """Whether the trial has run and no design of it stayed finite."""
        return len(self.curve) > 0 and not np.isfinite(self.curve).any()


@dataclass(frozen=True)
class Draws:
    """How many designs an operator drew, and how many of them were rejected as not buildable."""

    operator: str
    n_drawn: int
    n_rejected: int


@dataclass(frozen=True, eq=False)
class StudyReport:
    """A study, or as much of it as is done."""

    name: str
    title: str
    created_with: Mapping[str, str]  # version by package
    settings_yaml: str
    trials: Sequence[TrialResult] = ()
    residual_errors: Sequence[MemberError] = ()  # of changes per step, on held-out throws
    replays: Sequence[Replay] = ()
    findings: Findings = field(default_factory=Findings)
    draws: Sequence[Draws] = ()  # operators that rejected designs; empty where every design is buildable
    environments: Sequence[EnvironmentName] = tuple(ENVIRONMENTS)  # of the study's grid
    depths: Sequence[float] = (1.0, paper.DEPTH)  # of the study's grid [m]
    trains_networks: bool = True  # whether any part of the study needs networks
    measured_seconds: float = 20.0  # how long displacement is measured [s]. [P]
    digests: Sequence[tuple[str, str, str]] = ()  # stage, label and SHA-256 of every artifact
    failed: Sequence[str] = ()  # work items that failed, with their errors
    not_possible: Sequence[str] = ()  # work items that were not tried because an input failed
    diverged: Sequence[str] = ()  # trials with designs that diverged, and how many


@dataclass(frozen=True)
class TrialMean:
    """Mean and standard deviation of a measure over trials."""

    mean: float  # [m]
    sd: float | None  # sample standard deviation [m]; None with a single trial
    values: tuple[float, ...]  # one per trial with a finite value, in the order of the trials [m]


def trial_mean(trials: Iterable[TrialResult], measure: Measure) -> TrialMean | None:
    """Average a measure over the trials that have it; None if none has."""
    values = [value for trial in trials if (value := getattr(trial, measure)) is not None and np.isfinite(value)]
    if not values:
        return None
    return TrialMean(
        mean=float(np.mean(values)),
        sd=float(np.std(values, ddof=1)) if len(values) > 1 else None,
        values=tuple(float(value) for value in values),
    )


def ratio(part: TrialMean | None, whole: TrialMean | None) -> float | None:
    """Divide two means; None where one is missing or the whole is not positive."""
    if part is None or whole is None or whole.mean <= RESOLUTION:
        return None
    return part.mean / whole.mean


def paper_mean(environment: EnvironmentName, measure: Measure, depth: float) -> float | None:
    """Return the paper's mean over 10 trials [m], from a share where it gives only that; None where it gives neither.

    Args:
        environment: where the champions evolved.
        measure: what is averaged.
        depth: [m]
    """
    if depth != paper.DEPTH:
        return None
    arms = {(name, quantity): mean for (name, quantity), (mean, _) in paper.MEANS.items()}
    shares = {(name, quantity): share for (name, quantity), (share, _) in paper.RATIOS.items()}
    best = arms[BEST]
    arm = BEST if (environment, measure) == (BEST[0], "predicted") else (environment, measure)
    return arms[arm] if arm in arms else shares[arm] * best if arm in shares else None


def all_diverged(trials: Sequence[TrialResult]) -> bool:
    """Return whether trials have run and no design of any of them stayed finite."""
    return bool(trials) and all(trial.all_diverged for trial in trials)


ALL_DIVERGED = "every design of every trial diverged"  # reason for a page without champions


def depths(trials: Iterable[TrialResult]) -> list[float]:
    """List the depths of trials [m], shallowest first."""
    return sorted({trial.depth for trial in trials})


def deepest_scored(trials: Iterable[TrialResult]) -> float | None:
    """Find the greatest depth with a zero-shot champion [m]; None if there is none."""
    scored = [trial.depth for trial in trials if trial.zero_shot is not None and np.isfinite(trial.zero_shot)]
    return max(scored, default=None)


def arm(trials: Iterable[TrialResult], environment: EnvironmentName, depth: float) -> list[TrialResult]:
    """Return the trials of one environment and depth, ordered by number.

    Args:
        trials: of any environment and depth.
        environment: where the champions evolved.
        depth: [m]
    """
    chosen = [trial for trial in trials if trial.environment == environment and trial.depth == depth]
    return sorted(chosen, key=lambda trial: trial.trial)


def environments(trials: Iterable[TrialResult]) -> list[EnvironmentName]:
    """List the environments in which trials evolved, in their usual order."""
    present = {trial.environment for trial in trials}
    return [environment for environment in ENVIRONMENTS if environment in present]
