"""A recorded study, read back from its store."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.compute as pc

from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.report.render import as_html
from pipeline.results.study_tables import KEYS, SOURCES, available, field_of, keys_of, parts_of
from pipeline.stages import STAGES, environments
from pipeline.stages.data_sets import DataSetId, data_sets, ensemble_ids, networks_of
from pipeline.stages.files import ADAPTED, CHAMPION
from pipeline.stages.reader import StudyReader, read_study
from pipeline.store.store import Store, StudyRecord
from pipeline.store.tables import described
from pipeline.workflow.graph import Survey, survey
from pipeline.workflow.identity import TrialId, trials_of
from pipeline.workflow.record import recorded_study, settings_of
from pipeline.workflow.stage import Execution, Upstream
from tasks.analysis.columns import scored_by
from tasks.analysis.scores import ScoredTrial
from tasks.analysis.tables.transfer import TransferRow, transfer_rows
from tasks.design import Designs
from tasks.simulation import Rollouts
from tasks.world import Physics

if TYPE_CHECKING:
    from tasks.world import EnsembleMedium

CHAMPIONS = "champions"  # name of the table of champions

_CHAMPION_COLUMNS = {
    **KEYS,
    **dict.fromkeys(("predicted", "zero_shot", "adapted", "passive"), pa.float64()),
    **dict.fromkeys(("predicted_sd", "fitness"), pa.float64()),
    "design_json": pa.string(),
}


@dataclass(frozen=True)
class StageProgress:
    """Numbers of work items of a stage."""

    done: int
    failed: int  # that can't be computed, because they or work items before them failed
    missing: int  # that are still to be computed


@dataclass(frozen=True, repr=False)
class Study:
    """A recorded study as it is when it is first read; open it again to see what has been added since.

    Nothing is written, so that another user's store, or one on a read-only disk, can be read too.
    """

    store: Store
    record: StudyRecord
    settings: Settings

    def __repr__(self) -> str:
        done = ", ".join(f"{stage} {n.done} of {sum(vars(n).values())}" for stage, n in self.progress.items())
        return f"Study {self.name} in {self.store.root}\n  done: {done}\n  tables: {', '.join(self.tables)}"

    def _repr_html_(self) -> str:
        shown = f'<pre style="white-space: pre-wrap">{escape(repr(self))}</pre>'
        if not self.upstream["transfer"].done:
            return shown
        kind = scored_by(self.settings.evolution.maximised, TransferRow)
        rows, learners = transfer_rows(self.trials(), self.settings.target), self.settings.arm_learners
        table = as_html(kind, rows, self.name, learners=learners)
        return f"{shown}Champions in {self.settings.target_label}, mean ± SD over trials:{table}"

    @property
    def name(self) -> str:
        """Name of the study."""
        return self.record.name

    @cached_property
    def _recorded(self) -> Survey:
        return survey(self.settings, STAGES, self.store, record=self.record)

    @property
    def upstream(self) -> Upstream:
        """What the study has on record of each stage, by name."""
        return self._recorded.upstream

    @cached_property
    def reader(self) -> StudyReader:
        """What the study has on record, decoded when it is asked for."""
        return read_study(self.settings, self.upstream, self.store)

    @property
    def note(self) -> str:
        """A line that names stages of which today's code would make other results, or that other code made; or ""."""
        return self._recorded.note(self.name)

    @property
    def progress(self) -> dict[str, StageProgress]:
        """Work items that are done, failed and missing, by stage."""
        counts = {}
        for name, chains in self._recorded.chains.items():
            labels = {failure.label for failure in self.record.failed if failure.stage == name}
            n_left = {state.chain.label: state.chain.n_items - len(state.manifests) for state in chains}
            n_failed = sum(n for label, n in n_left.items() if label in labels)
            n_done = sum(len(state.manifests) for state in chains)
            counts[name] = StageProgress(n_done, n_failed, sum(n_left.values()) - n_failed)
        return counts

    @property
    def tables(self) -> list[str]:
        """Names of the tables that the study has."""
        return [*([CHAMPIONS] if self.upstream["transfer"].done else []), *available(self.upstream)]

    def table(
        self, name: str, *, environment: str | None = None, depth: float | None = None, trial: int | None = None
    ) -> pa.Table:
        """Return a table. Its first columns are environment, depth and trial; its schema names the units.

        Args:
            name: name of the table, such as "histories", "champions" or "predictions"; see ``tables``.
            environment: where designs evolved; None for all environments.
            depth: of the slush [m]; None for all depths.
            trial: number of the trial; None for all trials.

        Raises:
            PuddleError: there is no such table, environment, depth or trial, or an item of the store is damaged.
        """
        given = {"environment": environment, "depth": depth, "trial": trial}
        only = {key: value for key, value in given.items() if value is not None}
        self._check(only)
        if name == CHAMPIONS:
            table = self.champions()
        elif name in self.tables:
            parts = list(self.parts(name, only))
            if not parts:
                raise PuddleError(f"table {name}: study {self.name} has no rows with {_words(only)} yet")
            table = pa.concat_tables(parts)
        else:
            raise PuddleError(self._why_no_table(name))
        for key, value in only.items():
            if len(table) and table[key].null_count == len(table):
                raise PuddleError(f"table {name}: its rows have no {key}; expected no {key}, got {value!r}")
            table = table.filter(pc.equal(table[key], value))
        return table

    def parts(self, name: str, only: Mapping[str, Any] = MappingProxyType({})) -> Iterator[pa.Table]:
        """Yield a table chain by chain, for tables that are too long for the memory; ``only`` chains with such keys."""
        if name == CHAMPIONS:
            yield self.champions()
        else:
            objective = self.settings.evolution.maximised
            yield from parts_of(name, self.upstream, self.store, only=only, objective=objective)

    def champions(self) -> pa.Table:
        """Return the champion of every trial that is done and has one, in the order of the trials.

        Columns are displacements, called as in :class:`tasks.analysis.scores.ScoredTrial`, and design_json, the content
        of a design file. What another objective scores follows, such as zero_shot_score. What does not exist is null.
        """
        rows = [
            {**keys_of(trial), **scores, "design_json": self.reader.champion_files(trial)[CHAMPION].decode()}
            for trial in trials_of(self.settings, "transfer")
            if (scores := self.reader.scores.get(trial))
        ]
        about = {**described(ScoredTrial), "design_json": {"meaning": "Content of a design file."}}
        objective = self.settings.evolution.maximised
        about["fitness"] = {**about["fitness"], "unit": objective.unit}
        fields = [field_of(name, kind, about[name]) for name, kind in _CHAMPION_COLUMNS.items()]
        if not objective.is_papers:
            further = described(scored_by(objective, ScoredTrial))
            names = ("predicted", "predicted_sd", "zero_shot", "adapted", "passive")
            fields += [field_of(f"{name}_score", pa.float64(), further[name]) for name in names]
        return pa.Table.from_pylist(rows, schema=pa.schema(fields))

    def trials(self, *, displacement: bool = False) -> list[ScoredTrial]:
        """Return what is known of every trial's champion: its scores, or its displacements in any case."""
        return self.reader.scored_trials(displacement=displacement)

    def champion(self, environment: str, *, depth: float, trial: int, adapted: bool = False) -> Designs:
        """Return the champion of a trial, a design.

        Args:
            environment: where it evolved.
            depth: of the slush [m].
            trial: number of the trial.
            adapted: whether to return it with the controller that adapted to the target.

        Raises:
            PuddleError: there is no such trial, it is not done or was not adapted, or all its designs diverged.
        """
        self._check({"environment": environment, "depth": depth, "trial": trial})
        identity = TrialId("transfer", environment, depth, trial)
        where = f"study {self.name}: {environment} at {depth:g} m, trial {trial}"
        files = self.reader.champion_files(identity)
        if CHAMPION not in files:
            raise PuddleError(f"{where} has no champion: it is not done yet, or every design diverged")
        if adapted and ADAPTED not in files:
            raise PuddleError(f"{where} has no adapted champion: expected it in transfer.adapted_environments")
        return self.reader.design(identity, ADAPTED if adapted else CHAMPION)

    def simulate(
        self,
        designs: Designs,
        environment: str | None = None,
        *,
        depth: float | None = None,
        trial: int = 0,
        trace: bool = False,
        physics: Physics | None = None,
    ) -> Rollouts:
        """Simulate designs as the study does: with its rollout, physics, media and networks.

        Args:
            designs: n_designs designs, such as a champion.
            environment: a medium such as ``true_slush``, or one of the study's learners; by default the target.
            depth: of the ground below the surface [m]; by default the greatest of the study.
            trial: number of the trial whose networks a learner has.
            trace: whether to record the state after every step.
            physics: constants of the simulator; by default the study's.

        Raises:
            PuddleError: there is no such environment, or it is a learner that the study lacks.
            MissingInputs: a network is not trained yet.
        """
        environment = self.settings.target if environment is None else environment
        depth = max(self.settings.grid.depths) if depth is None else depth
        learner = self.settings.learner(environment)
        if learner is not None and environment != self.settings.target:
            self._check({"environment": environment, "trial": trial})
        elif environment not in self.settings.simulated_environments:
            known = ", ".join(self.settings.simulated_environments)
            raise PuddleError(f"study {self.name}: environment: expected one of {known}, got {environment!r}")
        of_trial = networks_of(TrialId("evolve", environment, depth, trial, self.settings.replicates), learner)
        networks = environments.read_networks(of_trial, self.upstream, self.store)
        spec = environments.simulation_spec(self.settings, environment)
        spec = replace(spec, physics=physics or spec.physics)
        at = environments.build_environment(spec.media, environment, depth, networks)
        return environments.roll_out(spec, Execution(self.settings.work.engine), at, designs, trace=trace)

    def ensemble(self, *, learner: str | None = None, replicate: int = 0) -> EnsembleMedium:
        """Return the trained networks, for ``ResidualSlush(depth=9.0, ensemble=study.ensemble())``.

        Args:
            learner: whose networks, such as ``designed_throws``; by default the main one.
            replicate: number of its data set.

        Raises:
            PuddleError: the study has no such ensemble.
            MissingInputs: a network is not trained yet.
        """
        known = data_sets(self.settings)
        name = learner or next((data_set.learner for data_set in known), "residual_slush")
        wanted = [data_set for data_set in known if data_set == DataSetId(name, replicate)]
        if not wanted:
            listed = ", ".join(data_set.label for data_set in known) or "none: no arm of its grid learns from throws"
            raise PuddleError(f"study {self.name} has networks of {listed}; got replicate {replicate} of {name}")
        networks = environments.read_networks(ensemble_ids(self.settings, wanted[0]), self.upstream, self.store)
        return environments.ensemble_of(networks)

    def _check(self, only: Mapping[str, Any]) -> None:
        """Refuse values of keys that no trial of the study has, together with those before them."""
        trials, where = [keys_of(trial) for trial in trials_of(self.settings, "evolve")], f"study {self.name}"
        for key, value in only.items():
            known = list(dict.fromkeys(trial[key] for trial in trials))
            if value not in known:
                listed = ", ".join(f"{choice:g}" if isinstance(choice, float) else str(choice) for choice in known)
                raise PuddleError(f"{where}: {key}: expected one of {listed}, got {value!r}")
            trials, where = [trial for trial in trials if trial[key] == value], f"{where}, {key} {value}"

    def _why_no_table(self, name: str) -> str:
        if name in SOURCES:
            stage = SOURCES[name].stage
            return f"table {name}: study {self.name} has none: {stage} is not done, or its settings need none"
        listed = ", ".join((CHAMPIONS, *SOURCES))
        return f"study {self.name}: expected a table, one of {listed}; got {name!r}"


def _words(only: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} {value}" for key, value in only.items())


def open_study(name: str, store: str | Path = "store", *, say: Callable[[str], None] | None = None) -> Study:
    """Open a recorded study, and name in a line the stages that other code made.

    Raises:
        PuddleError: there is no store or no such study (the message lists those there are), or its record is damaged
            or that of another version of puddle.
    """
    opened = Store.open(Path(store), create=False)
    record = recorded_study(opened, name)
    study = Study(opened, record, settings_of(record))
    if say is not None and study.note:
        say(study.note)
    return study
