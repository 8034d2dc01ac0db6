"""puddle status: how far a study has got, by what its record lists and what its settings lead to."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field

from pipeline.commands.options import AsJson, StudyOptions, to_copy, with_options
from pipeline.commands.terminal import print_json, to_stdout
from pipeline.config.settings import Settings
from pipeline.errors import DamagedArtifact
from pipeline.stages import STAGES
from pipeline.store.store import Store, StudyRecord
from pipeline.workflow.graph import survey
from pipeline.workflow.record import differences as differences_of
from pipeline.workflow.record import settings_of


@with_options
def status(options: StudyOptions, as_json: AsJson = False) -> None:
    """Print what of a study is done, running, failed and missing.

    Where the store has a study of that name, its recorded settings count, and differences from those given are named.
    """
    store, settings = options.open_store(), options.settings(to_compute=False)
    record = store.read_study(settings.name)
    recorded = settings_of(record) if record else settings
    differences = differences_of(recorded, settings)
    found = study_status(recorded, store, record, with_diverged=True)
    if as_json:
        print_json({**asdict(found), "done": found.is_done, "settings_differ": differences})
        return
    to_stdout(*status_lines(found))
    if differences:
        to_stdout(
            "That is the study on record. The settings given differ from it (recorded → given):",
            *(f"  {line}" for line in differences),
            "`puddle forecast` with the same options shows what they would need.",
        )
    elif record is None and (names := store.studies()):
        asked = to_copy("status NAME", options.store)
        to_stdout(f"The store has no study {settings.name}, but {', '.join(names)}: `{asked}`.")


@dataclass(frozen=True)
class StageStatus:
    """How far a stage has got."""

    stage: str
    state: str  # "done", "running", "started", "missing" or "not needed"
    n_done: int  # items
    n_items: int
    units_done: float
    units: float
    unit: str  # unit of work, in the plural
    core_seconds: float
    failed: Mapping[str, str] = field(default_factory=dict)  # why, by chain
    diverged: Mapping[str, str] = field(default_factory=dict)  # what, by chain
    n_other_code: int = 0  # items that a different version of the code made

    @property
    def line(self) -> str:
        """The stage on the terminal."""
        work = f", {self.units_done:,.0f} of {self.units:,.0f} {self.unit}" if self.units >= 1 else ""
        items = f"{self.n_done:>6} of {self.n_items} items"
        return f"  {self.stage:<9} {self.state:<10} {items}{work}, {self.core_seconds:.0f} core-seconds"


@dataclass(frozen=True)
class StudyStatus:
    """How far a study has got."""

    study: str
    store: str
    driver: str | None  # the process that drives it
    stages: tuple[StageStatus, ...]
    notes: tuple[str, ...] = ()

    @property
    def is_done(self) -> bool:
        """Whether nothing is left to do or to try again."""
        return self.open_stage is None and not any(stage.failed for stage in self.stages)

    @property
    def open_stage(self) -> StageStatus | None:
        """The first stage that is not done."""
        return next((stage for stage in self.stages if stage.state not in ("done", "not needed")), None)

    @property
    def short(self) -> str:
        """The progress in a few words."""
        if stage := self.open_stage:
            number = self.stages.index(stage) + 1
            running = "running, " if self.driver else ""
            items = f"{stage.n_done:,} of {stage.n_items:,} items"
            return f"{running}stage {number} of {len(self.stages)}: {stage.stage}, {items}"
        return "done" if self.is_done else "done, except for what failed (`puddle status` names it)"


def study_status(settings: Settings, store: Store, record: StudyRecord | None, *, with_diverged: bool) -> StudyStatus:
    """Return how far a study has got: recorded items count by their keys, whatever today's code would make of them.

    To look for designs that diverged reads the curves of every trial.
    """
    notes: list[str] = []
    found = survey(settings, STAGES, store, record=record, say=notes.append)
    driver = store.driver_of(settings.name)
    failed: dict[str, dict[str, str]] = defaultdict(dict)
    for one in record.failed if record else ():
        failed[one.stage][one.label] = one.why
    stages: list[StageStatus] = []
    any_open = False  # a driver runs the stages in order: the first open one is the one that runs
    for stage in STAGES:
        chains, results = found.chains[stage.name], found.upstream[stage.name]
        finished = {one.chain.label for one in chains if one.finished}
        n_done, n_items = sum(len(one.manifests) for one in chains), sum(one.chain.n_items for one in chains)
        if len(finished) == len(chains):
            state = "done" if chains else "not needed"
        elif driver and not any_open:
            state = "running"
        else:
            state = "started" if n_done else "missing"
        any_open = any_open or state not in ("done", "not needed")
        diverged: dict[str, str] = {}
        try:
            if with_diverged:
                diverged = {one.label: what for one, what in stage.diverged(settings, found.upstream, store).items()}
        except DamagedArtifact as damage:
            notes.append(str(damage))
        stages.append(
            StageStatus(
                stage.name,
                state,
                n_done,
                n_items,
                sum(sum(one.chain.units[: len(one.manifests)]) for one in chains),
                sum(sum(one.chain.units) for one in chains),
                stage.unit,
                results.seconds,
                {label: why for label, why in failed[stage.name].items() if label not in finished},
                diverged,
                results.n_other_code,
            )
        )
    notes += filter(None, [found.note(settings.name)])
    return StudyStatus(settings.name, str(store.root), driver, tuple(stages), tuple(notes))


def status_lines(status: StudyStatus) -> Iterator[str]:
    """Describe the study and each stage, each failed chain, and each trial whose designs diverged."""
    yield f"study {status.study} in {status.store}"
    yield f"driven by {status.driver}" if status.driver else "no process is driving it"
    for stage in status.stages:
        yield stage.line
        yield from (f"    {label}: {why}" for label, why in [*stage.failed.items(), *stage.diverged.items()])
    if any(stage.diverged for stage in status.stages):
        yield "Designs that diverged would diverge again with the same settings; everything else is safe."
    if any(stage.failed for stage in status.stages):
        yield "Failed work items are tried again by the next `puddle study`; everything else is safe."
    yield from status.notes
