"""The results of the analysis as the page shows them: rows of the analysis tables, and why some are missing."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from tasks.analysis.against_paper import Row
from tasks.analysis.attribution import Attribution, TransferMatrix
from tasks.analysis.comparison import Contrast
from tasks.analysis.coverage import CoverageRow
from tasks.analysis.luck import Luck
from tasks.analysis.member_error import MemberError
from tasks.analysis.prediction import Histograms, Regression
from tasks.analysis.scores import EvolvedIn
from tasks.analysis.tank import Crossing, Tank, TankTrials
from tasks.analysis.uncertainty import Estimate
from tasks.analysis.variance_split import VarianceRow
from tasks.arrays import Float64
from tasks.evolution import PAPERS_OBJECTIVE, ObjectiveName
from tasks.world import EnvironmentName


@dataclass(frozen=True)
class ExploiterRow:
    """A ranked design: the prediction of the ensemble and its true displacement [m]; None where it diverged."""

    rank: int
    kind: Literal["champion", "assessed"]
    environment: EvolvedIn
    depth: float
    trial: int
    generation: int  # -1 for a champion, like ``identity``
    identity: int
    predicted: float | None
    true: float | None
    excess: float | None
    disagreement: float | None  # standard deviation over the members
    ranked_by: str
    reason: str | None
    by_member: tuple[float, ...]  # (n_members,) displacement under each member


@dataclass(frozen=True)
class Moved:
    """Displacements of one champion [m]; None where it diverged or was not simulated."""

    displacement: float | None
    com: float | None
    reach: float | None  # displacement of the root minus that of the centre of mass


@dataclass(frozen=True)
class ChampionRow:
    """A champion simulated again, where it evolved and in True Slush; lengths in m, None where it diverged."""

    trial: int
    best: bool  # whether it is the best zero-shot, or the best where it evolved if none survives True Slush
    home: Moved  # where it evolved, mean over members
    slush: Moved  # in True Slush
    luck: Luck = field(metadata={"prefix": False})


@dataclass(frozen=True)
class ChampionCoverageRow:
    """How far the states of one champion are from the throws, in all or because of one component."""

    trial: int
    coverage: CoverageRow = field(metadata={"prefix": False})


@dataclass(frozen=True)
class TankRow:
    """A champion in the virtual tank; displacements in m, None where it diverged."""

    trial: int
    proposed: bool  # whether it is proposed for building: the nearest to the champions' mean in True Slush
    zero_shot: float | None  # displacement of its root in True Slush, at its own depth
    dry_land: float | None  # displacement of its root on Dry Land, at its own depth and for as long
    dry_land_com: float | None  # displacement of its centre of mass on Dry Land
    wet: Crossing  # first trial in the filled tank
    dry: Crossing  # first trial on the floor of the drained tank
    dry_servo: Crossing  # the same with the servo's torque at scale as the motors' limit
    motor_torque: float  # limit of the motors in the simulation [N·m]
    servo_torque: float  # the servo's torque at the scale of the simulation [N·m]
    wet_trials: TankTrials
    dry_trials: TankTrials
    dry_servo_trials: TankTrials


@dataclass(frozen=True, eq=False)
class ThrowPaths:
    """The throws of the data set: paper, Fig. 2."""

    length_scale: Float64  # (n_throws,) long axis of the link [m]
    path: Float64  # (n_throws, n_steps, 3) x, y [m], angle [rad]
    seconds: float  # duration of each [s]
    n_learned: int  # throws that the networks were trained on; the others were held out


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Accuracy of the predicted displacement in True Slush: paper, Fig. 3."""

    depth: float  # [m]
    regressions: Sequence[Regression]  # for every member ("member 0", ...) and aggregate ("mean", "mean - 1 sd", ...)
    histograms: Histograms  # for the members and their mean, and the means of the other ensembles


@dataclass(frozen=True)
class Ancestor:
    """A design in the family of a champion, which includes the champion."""

    identity: int  # running number within the trial
    generation: int  # generation of its birth
    age: int  # age of its genes at birth [generations]
    operator: str  # operator that made it: "random", "mutation" or "crossover"
    parents: tuple[int, ...]  # identities; empty for a random design
    fitness: float  # where it evolved, in the objective's unit; -inf if it diverged
    n_genes_changed: int | None  # genes that differ from the more similar parent; None for a random design


@dataclass(frozen=True)
class Family:
    """The ancestors of a champion."""

    label: str  # the champion, in words
    ancestors: Sequence[Ancestor]  # ordered by identity, the champion last


@dataclass(frozen=True, eq=False)
class Findings:
    """All results of the analysis, or as many as there are."""

    throws: ThrowPaths | None = None
    coverage: Mapping[str, Mapping[EnvironmentName, Sequence[CoverageRow]]] = field(default_factory=dict)
    """How far pilots are from the throws: by data set in words, and by the environment where they were seen."""
    accuracy: Accuracy | None = None
    other_regressions: Sequence[Regression] = ()  # of the ensembles that learned from other throws
    against_paper: Sequence[Row] = ()
    objective: ObjectiveName = PAPERS_OBJECTIVE  # what designs were selected for
    selected_for: str = "displacement"  # the objective, in words
    contrasts: Sequence[Contrast] = ()
    attributions: Sequence[Attribution] = ()
    variances: Sequence[VarianceRow] = ()
    transfer_matrices: Mapping[EvolvedIn, TransferMatrix] = field(default_factory=dict)  # by where champions evolved
    exploiters: Sequence[ExploiterRow] = ()  # ordered by rank
    champions: Mapping[str, Sequence[ChampionRow]] = field(default_factory=dict)  # by arm, in words
    champion_coverage: Mapping[tuple[EnvironmentName, float], Sequence[ChampionCoverageRow]] = field(
        default_factory=dict
    )  # how far champions are from the throws where they evolved, by environment and depth [m]
    phantom_thrust: Sequence[Estimate] = ()  # one per member [m/s²]
    member_errors: Sequence[MemberError] = ()
    family: Family | None = None
    tank: Tank | None = None
    tank_tests: Mapping[str, Sequence[TankRow]] = field(default_factory=dict)  # by arm, in words
    missing: Mapping[str, str] = field(default_factory=dict)  # reason by field of this class, where a stage gives one

    @property
    def replicated(self) -> Sequence[VarianceRow]:
        """The variances of arms with several replicates."""
        return [row for row in self.variances if row.n_replicates > 1]

    def why(self, name: str, otherwise: str) -> str:
        """Return the reason why a field is empty."""
        return self.missing.get(name, otherwise)
