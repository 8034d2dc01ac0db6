"""What an analysis is: a function from earlier results to the rows of a table, registered under the table's name.

An analysis is one file in ``tasks/analysis/tables``. From its registration follow the work items that compute it, the
Parquet file, ``study.table(name)``, the CSV, MLflow's artifact, and the table on the page. Its columns are the fields
of a frozen dataclass, described here and nowhere else::

    @dataclass(frozen=True)
    class Reach(OfTrial):
        longest: float = column("longest link", "m", meaning="Long axis of a champion's longest link.")

    @analysis("reach", row=Reach, reads=("transfer",), answers="How long are champions' links?", section="more")
    def reach(study: StudyData) -> list[Reach]: ...
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, make_dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol, get_type_hints

from tasks.evolution import Objective
from tasks.residual.learner import NO_LEARNERS, Learner, arm_kind
from tasks.world import EnvironmentName

if TYPE_CHECKING:
    from numpy.random import Generator

    from tasks.analysis.scores import Champion, ScoredTrial
    from tasks.analysis.tank import Tank
    from tasks.arrays import Float64, Int64
    from tasks.design import Designs
    from tasks.evolution import Deviation, Population
    from tasks.simulation import Rollouts
    from tasks.world import EnsembleMedium, Environment, Physics

Form = str | Callable[[Any], str]  # a format, such as "{:.1f}", or a function that writes a value
Section = Literal["transfer", "paper", "networks", "trust", "tank", "more", ""]
"""Section of the page that shows a table; in those of "" it is a download alone."""


class ScoreUnit(str):
    """Unit of scores, which :func:`scored_by` replaces."""


SCORE = ScoreUnit("m")


def column(
    label: str, unit: str = "", *, form: Form = "{:z.1f}", meaning: str = "", shown: bool = True, default: Any = MISSING
) -> Any:
    """Describe a column, the field of a row: its heading, unit, how a number is written, and what it means.

    ``meaning`` is a sentence, where the label does not say it all. A column that is not shown is in files alone. The
    unit of what depends on the study's objective is ``SCORE``.
    """
    return field(
        default=default, metadata={"label": label, "unit": unit, "form": form, "meaning": meaning, "shown": shown}
    )


def scored_by(objective: Objective, row: type) -> type:
    """Return a kind of row as a study of an objective describes it: its scores are in the objective's unit."""
    if objective.is_papers:
        return row
    types, columns = get_type_hints(row), []
    for one in fields(row):
        about = dict(one.metadata)
        if isinstance(about["unit"], ScoreUnit):
            meaning = about["meaning"].replace("Displacement of the root", objective.label)
            about |= {"unit": objective.unit, "form": about["form"].replace(".1f", ".2f"), "meaning": meaning}
        columns.append((one.name, types[one.name], field(metadata=about)))
    return make_dataclass(row.__name__, columns)


def environment_name(name: str, learners: Mapping[str, Learner] = NO_LEARNERS) -> str:
    """Write an environment with its symbol, in a study with these learners."""
    kind = arm_kind(name, learners)
    return f"{kind.label}, {kind.symbol}"


def percent(share: float) -> str:
    """Write a share in whole per cent."""
    return f"{100 * share:z.0f} %"


@dataclass(frozen=True)
class OfArm:
    """The first columns of a table about arms."""

    environment: EnvironmentName = column("evolved in", form=environment_name)
    depth: float = column("depth", "m", form="{:g}")


@dataclass(frozen=True)
class OfTrial(OfArm):
    """The first columns of a table about champions."""

    trial: int = column("trial", form="{}")


@dataclass(frozen=True, eq=False)
class Assessed:
    """Designs drawn from whole runs, simulated in the target and under every member of an ensemble."""

    predicted: Float64  # (n_members, n_designs) [m]; NaN where diverged
    true: Float64  # (n_designs,) [m]; NaN where diverged
    trial: Sequence[str]  # (n_designs,) the trial of each, which are samples
    replicate: Int64  # (n_designs,)


@dataclass(frozen=True)
class AnalysisSettings:
    """Settings of a study that analyses use."""

    assessed_depth: float  # depth at which designs are assessed [m]
    learners: Mapping[EnvironmentName, Learner]  # of the arms, those of the main ensemble first
    deviation: Deviation  # what σ over members is
    tank: Tank | None  # the virtual tank, if the study has one
    physics: Physics  # constants of the base simulator
    n_settle: int  # steps of a rollout before displacement is measured

    @property
    def data_sets(self) -> tuple[str, ...]:
        """Names of the data sets that ensembles learned from, the main one first."""
        return tuple(dict.fromkeys(learner.data_set for learner in self.learners.values()))


class StudyData(Protocol):
    """What an analysis may use: settings, and the results of the stages that it reads, for the trials of its item."""

    @property
    def settings(self) -> AnalysisSettings:
        """Settings of the study."""

    @property
    def trials(self) -> Sequence[ScoredTrial]:
        """Every trial, with what is known of it."""

    @property
    def champions(self) -> Sequence[Champion]:
        """The champions that there are, in the order of the trials."""

    @property
    def populations(self) -> Mapping[tuple[EnvironmentName, float, int], Population]:
        """What the search of each trial knows at its end, by environment, depth [m] and number of the trial."""

    def assessed(self, data_set: str) -> Assessed | None:
        """Return the designs that the ensemble of a data set was assessed with, if any."""

    @property
    def target(self) -> EnvironmentName:
        """The environment that champions are transferred to."""

    @property
    def has_papers_target(self) -> bool:
        """Whether scores are comparable with the paper's."""

    def at_target(self, depth: float) -> Environment:
        """Return the target at a depth [m]."""

    def ensemble(self, champion: Champion | None = None) -> EnsembleMedium:
        """Return the ensemble that serves a champion, by default the main one; the same object for all it serves."""

    def simulate(
        self,
        environment: Environment,
        designs: Designs,
        *,
        trace: bool = False,
        physics: Physics | None = None,
        n_measure: int | None = None,
    ) -> Rollouts:
        """Simulate designs as the study does, unless physics or the number of steps are given."""

    def score(self, environment: Environment, designs: Designs) -> Float64:
        """Return (n_designs, n_members) scores of designs, in the unit of the study's objective."""

    def rng(self, *identity: str | float) -> Generator:
        """Return a generator that the study's seed and what it is for decide."""


@dataclass(frozen=True)
class Analysis:
    """A registered table."""

    name: str
    row: type  # dataclass of its rows
    compute: Callable[[StudyData], Sequence[Any]]
    reads: tuple[str, ...]  # names of the stages whose results it needs
    answers: str  # the question that the table answers
    section: Section = ""
    each: Literal["study", "arm"] = "study"  # what one work item covers
    version: int = 1  # raised when the same results would give other rows than before
    shown: Callable[[Any], bool] = lambda row: True  # rows that the page shows
    metrics: Callable[[Sequence[Any]], Mapping[str, float | None]] = lambda rows: {}  # by which MLflow compares studies
    needs_tank: bool = False  # whether it is about the virtual tank, which few studies have
    search: str | None = None  # the search whose studies it is about, if not all of them
    cost: float = 1.0  # about how many rollouts of a champion it takes


ANALYSES: dict[str, Analysis] = {}
"""Every analysis by name. Complete once ``tasks.analysis.tables`` is imported."""


def analysis(name: str, **about: Any) -> Callable[[Callable[[StudyData], Any]], Callable[[StudyData], Any]]:
    """Register the function below as the analysis that makes a table; ``about`` are fields of :class:`Analysis`."""
    if name in ANALYSES:
        raise ValueError(f"analysis {name!r} is registered twice, expected a name of its own")

    def register(compute: Callable[[StudyData], Any]) -> Callable[[StudyData], Any]:
        ANALYSES[name] = Analysis(name=name, compute=compute, **about)
        return compute

    return register
