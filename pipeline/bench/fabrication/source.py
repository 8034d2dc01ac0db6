"""The source of a kit's design: a file, or the champion of a study that the paper's rule selects."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.results.recorded_study import Study
from pipeline.stages import environments
from pipeline.stages.data_sets import NetworkId, networks_of
from pipeline.store.design_file import load_design
from pipeline.workflow.identity import TrialId
from pipeline.workflow.stage import Files, MissingInputs
from tasks.analysis.tank import nearest_the_mean
from tasks.design import Designs
from tasks.residual import arm_kind
from tasks.simulation import OK
from tasks.world import EnvironmentName, in_order

_PHYSICAL_DEPTH = 2.0  # of the slush in which a design file is simulated [m]; paper, "Physical Validation"


@dataclass(frozen=True, eq=False)
class DesignSource:
    """A design and its origin."""

    design: Designs
    name: str
    origin: str  # where the design comes from, in words
    settings: Settings  # settings of the study, or those for simulating a design file
    depth: float  # depth of the slush in the simulation [m]
    predicted: tuple[float, ...] | None
    """(n_members) displacements that the study's ensemble predicts [m of simulation], if there is one."""
    networks: Mapping[NetworkId, Files] = field(default_factory=dict)  # of a learned target

    @property
    def environment(self) -> str:
        """Environment of the simulation, in words."""
        return f"{self.settings.target_label} at {self.depth:g} m"

    @property
    def prediction(self) -> tuple[float, float] | None:
        """Mean and standard deviation of ``predicted`` [m of simulation]."""
        return None if self.predicted is None else (float(np.mean(self.predicted)), float(np.std(self.predicted)))


def from_file(path: Path, settings: Settings) -> DesignSource:
    """Read a design file, to be simulated with some settings. Raises PuddleError if it is invalid."""
    where = f"{settings.target_label} at {_PHYSICAL_DEPTH:g} m"
    origin = f"Design file {path.name}, simulated in {where} with the settings of {settings.name}."
    return DesignSource(load_design(path), path.stem, origin, settings, _PHYSICAL_DEPTH, None)


def proposed(study: Study) -> DesignSource:
    """Select the champion whose zero-shot score is nearest the mean of its arm. Paper, "Physical Validation".

    The arm is the study's first learner with an ensemble, or else its first arm, at its greatest depth. Raises
    PuddleError if a champion has not been scored, which would shift the mean, or none survived.
    """
    if n_missing := study.progress["transfer"].missing:
        raise PuddleError(f"study {study.name!r}: {n_missing} champions have no score yet. Run `puddle study` first.")
    champions = [row for row in study.trials() if np.isfinite(row.zero_shot)]
    if not champions:
        raise PuddleError(f"study {study.name!r}: no champion survived {study.settings.target_label}")
    arms = {(row.environment, row.depth) for row in champions}
    order = [*_ensembles(study), *in_order(environment for environment, _ in arms)]
    environment, depth = min(arms, key=lambda arm: (order.index(arm[0]), -arm[1]))
    rows = [row for row in champions if (row.environment, row.depth) == (environment, depth)]
    zero_shot, unit = np.array([row.zero_shot for row in rows]), study.settings.evolution.maximised.unit
    chosen = nearest_the_mean(zero_shot) or 0  # there is one, because all scores are finite
    trial = rows[chosen].trial
    design = study.champion(environment, depth=depth, trial=trial)
    evolved = arm_kind(environment, study.settings.arm_learners).evolved
    origin = (
        f"Champion of trial {trial} of study {study.name}, evolved {evolved} at {depth:g} m. "
        f"It scores {zero_shot[chosen]:+.2f} {unit} in {study.settings.target_label}, nearest to the mean of "
        f"{len(rows)} champions, {zero_shot.mean():+.2f} {unit}."
    )
    name, predicted = f"{study.name}-trial-{trial}", _predictions(study, design, environment, depth, trial)
    transferred, target = TrialId("transfer", environment, depth, trial), study.settings.learner(study.settings.target)
    networks = environments.read_networks(networks_of(transferred, target), study.upstream, study.store)
    return DesignSource(design, name, origin, study.settings, depth, predicted, networks)


def _ensembles(study: Study) -> list[EnvironmentName]:
    """List the arms that are learners with an ensemble, in the order of the grid."""
    learners = study.settings.arm_learners
    return [name for name in study.settings.grid.environments if name in learners and not learners[name].is_single]


def _predictions(
    study: Study, design: Designs, environment: EnvironmentName, depth: float, trial: int
) -> tuple[float, ...] | None:
    """Simulate a trial's design under every member of its own ensemble, or of the study's first, if there is one."""
    ensembles = _ensembles(study)
    if not ensembles:
        return None
    try:
        rollouts = study.simulate(
            design, environment if environment in ensembles else ensembles[0], depth=depth, trial=trial
        )
    except MissingInputs:
        return None
    return tuple(rollouts.displacement[:, 0].tolist()) if (rollouts.status == OK).all() else None
