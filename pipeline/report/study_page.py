"""What the page shows of a study, and the registry of its figures.

A figure is a function of the page, registered under its own name with its heading, section and caption. From that
follow its place on the page, its files, and its part of an export::

    @page_figure("The throws", section="networks", caption="Paths of the thrown links in {target}.")
    def data_set(page: StudyPage) -> Figure: ...
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from matplotlib.figure import Figure

from pipeline.config.settings import Settings
from pipeline.report.palette import Look, looks_of
from pipeline.report.replay import Replay
from tasks.analysis import paper
from tasks.analysis.study import Assessed
from tasks.analysis.tables.regressions import ensemble_name
from tasks.arrays import Float64

Curves = Mapping[tuple[str, float], Sequence[Float64]]
"""Best fitness by generation of each trial, by arm: environment and depth [m]."""


@dataclass(frozen=True, eq=False)
class ThrowPaths:
    """The throws of a data set."""

    length_scale: Float64  # (n_throws,) long axis of the link [m]
    path: Float64  # (n_throws, n_steps, 3) x, y [m], angle [rad]; NaN where a throw lacks a step


@dataclass(frozen=True, eq=False)
class StudyPage:
    """A study, or as much of it as is done. Nothing is required: a study that has only begun has a page, too."""

    settings: Settings
    tables: Mapping[str, Sequence[Any]] = field(default_factory=dict)  # rows by name of the analysis
    curves: Curves = field(default_factory=dict)
    assessed: Mapping[str, Assessed] = field(default_factory=dict)  # by learner, the main one first
    throws: ThrowPaths | None = None  # of the main data set
    replays: Sequence[Replay] = ()
    rejected: Mapping[str, float] = field(default_factory=dict)  # share of drawn designs, by operator
    created_with: Mapping[str, str] = field(default_factory=dict)  # version by package
    digests: Sequence[tuple[str, str, str]] = ()  # stage, label and SHA-256 of every chain that is done
    failed: Sequence[str] = ()  # work items that failed, with their errors
    not_possible: Sequence[str] = ()  # work items that were not tried because an input failed
    diverged: Sequence[str] = ()  # trials with designs that diverged, and how many

    @property
    def looks(self) -> dict[str, Look]:
        """How the arms are drawn."""
        arms = (environment for environment, _, _ in self.settings.trials())
        return looks_of(arms, self.settings.target, self.settings.arm_learners)

    @property
    def target(self) -> str:
        """Where champions are transferred to, as readers know it."""
        return self.settings.target_label

    @property
    def score_label(self) -> str:
        """Label of an axis of scores in the target."""
        objective = self.settings.evolution.maximised
        return objective.with_unit(f"{objective.label.lower()} in {self.target}")

    def rows(self, name: str) -> Sequence[Any]:
        """Return the rows of an analysis."""
        return self.tables.get(name, ())


def scale_words(settings: Settings) -> str:
    """Say how the study's scale of evolution compares with the paper's, if both are known."""
    n_designs = settings.evolution.population_size
    if n_designs is None or not settings.has_papers_target:
        return ""
    share = paper.N_EVALUATED / (settings.evolution.n_generations * n_designs)
    if share < 1.5:
        return ""
    advice = "compare shares, not metres" if share < 500 else "the figures mean nothing"
    return f"1/{share:,.0f} of the paper’s evolution: {advice}"


Draw = Callable[[StudyPage], Figure]


@dataclass(frozen=True)
class PageFigure:
    """A registered figure."""

    title: str
    section: str  # of the page
    caption: str  # may name the {target}, the {score} and the {main} ensemble
    draw: Draw

    def drawn(self, page: StudyPage) -> tuple[Figure, str]:
        """Draw it for a study, and complete its caption."""
        score, ensembles = page.settings.evolution.maximised.label, page.settings.ensembles
        thrown = ensemble_name(next(iter(ensembles)), page.settings.arm_learners) if ensembles else ""
        return self.draw(page), self.caption.format(target=page.target, score=score, main=thrown)


FIGURES: dict[str, PageFigure] = {}
"""Every figure by name. Complete once ``pipeline.report.page`` is imported."""


def page_figure(title: str, *, section: str, caption: str) -> Callable[[Draw], Draw]:
    """Register the function below, which draws a figure or raises NothingToDraw; arguments as :class:`PageFigure`."""

    def register(draw: Draw) -> Draw:
        FIGURES[draw.__name__] = PageFigure(title, section, caption, draw)
        return draw

    return register
