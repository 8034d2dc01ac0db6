"""What an analysis is: a function from earlier results to the rows of a table, registered under the table's name.

An analysis is one file in ``tasks/analysis/tables``. From its registration follow the work items that compute it, the
Parquet file, ``study.table(name)``, the CSV, MLflow's artifact, and the table on the page. Its columns are the fields
of a frozen dataclass, described here and nowhere else::

    @dataclass(frozen=True)
    class Reach(OfTrial):
        longest: float = column("longest link", "m", meaning="Long axis of a champion's longest link.")

    @analysis("reach", row=Reach, reads=("champions",), answers="How long are champions' links?", section="more")
    def reach(study: StudyData) -> list[Reach]: ...
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from tasks import discovery
from tasks.analysis.study import StudyData

Read = Literal["champions", "populations", "networks", "predictions"]
"""Champions with their scores, what searches know at their ends, ensembles, and assessed designs."""
Section = Literal["transfer", "paper", "networks", "trust", "tank", "more", ""]
"""Section of the page that shows a table; in those of "" it is a download alone."""


@dataclass(frozen=True)
class Analysis:
    """A registered table."""

    name: str
    row: type  # dataclass of its rows
    compute: Callable[[StudyData], Sequence[Any]]
    reads: tuple[Read, ...]  # what it reads of a study
    answers: str  # the question that the table answers
    section: Section = ""
    each: Literal["study", "arm"] = "study"  # what one work item covers
    version: int = 1  # raised when the same results would give other rows than before
    by_depth: bool = True  # whether the page shows the rows depth by depth, if they have depths
    shown: Callable[[Any], bool] = lambda row: True  # rows that the page shows
    metrics: Callable[[Sequence[Any]], Mapping[str, float | None]] = lambda rows: {}  # by which MLflow compares studies
    needs_engines: bool = False  # whether it is about other engines, in which few studies score
    needs_tank: bool = False  # whether it is about the virtual tank, which few studies have
    search: str | None = None  # the search whose studies it is about, if not all of them
    cost: float = 1.0  # about how many rollouts of a champion it takes


ANALYSES: dict[str, Analysis] = {}
"""Every analysis by name. Complete once ``tasks.analysis.tables`` is imported."""


def analysis(name: str, **about: Any) -> Callable[[Callable[[StudyData], Any]], Callable[[StudyData], Any]]:
    """Register the function below as the analysis that makes a table; ``about`` are fields of :class:`Analysis`."""

    def register(compute: Callable[[StudyData], Any]) -> Callable[[StudyData], Any]:
        discovery.register(ANALYSES, "analysis", name, Analysis(name=name, compute=compute, **about))
        return compute

    return register
