"""The source of a kit's design: a file, or the champion of a study that the paper's rule selects."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.stages import STAGES, environments
from pipeline.stages.data_sets import data_set_of, main_data_set
from pipeline.stages.environments import WEIGHTS
from pipeline.stages.transfer import CHAMPION, read_scores
from pipeline.store.design_file import design_from, read_design
from pipeline.store.encoding import decode_json
from pipeline.store.store import Store
from pipeline.workflow.identity import TrialId, arms_of
from pipeline.workflow.recorded import recorded_results
from pipeline.workflow.stage import Execution, MissingInputs, Results
from tasks.analysis.tank import nearest_the_mean
from tasks.design import Designs
from tasks.simulation import OK

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
    true_slush: float | None = None  # its score in True Slush [m of simulation], if the study has one

    @property
    def environment(self) -> str:
        """Environment of the simulation, in words."""
        return f"True Slush at {self.depth:g} m"

    @property
    def prediction(self) -> tuple[float, float] | None:
        """Mean and standard deviation of ``predicted`` [m of simulation]."""
        return None if self.predicted is None else (float(np.mean(self.predicted)), float(np.std(self.predicted)))


def from_file(path: Path, settings: Settings) -> DesignSource:
    """Read a design file, to be simulated with some settings. Raises PuddleError if it is invalid."""
    where = f"True Slush at {_PHYSICAL_DEPTH:g} m"
    origin = f"Design file {path.name}, simulated in {where} with the settings of {settings.name}."
    return DesignSource(read_design(path), path.stem, origin, settings, _PHYSICAL_DEPTH, None)


def proposed(settings: Settings, store: Store) -> DesignSource:
    """Select the champion whose True Slush score is nearest the mean of its arm. Paper, "Physical Validation".

    The arm is Residual Slush if the study has it, at its greatest depth. Raises PuddleError if no champion has been
    scored or survived, or an item of the study is damaged.
    """
    with store.lock_to_read():
        return _proposed(settings, store)


def _proposed(settings: Settings, store: Store) -> DesignSource:
    damage: list[str] = []
    record = store.read_study(settings.name)
    upstream = recorded_results(settings, record, STAGES, store, say=damage.append).upstream
    if damage:  # a missing trial would shift the mean and select another champion
        raise PuddleError(damage[0])
    found = read_scores(settings, upstream["transfer"], store).items()
    scored = {trial: scores for trial, scores in found if scores is not None and np.isfinite(scores.zero_shot)}
    if not scored:
        raise PuddleError(
            f"study {settings.name!r}: no champion has a score in True Slush yet. Run `puddle study` first."
        )
    arms = arms_of(list(scored))
    arm = min(arms, key=lambda arm: (arm.environment != "residual_slush", -arm.depth, arm.environment))
    trials = arms[arm]
    zero_shot = np.array([scored[trial].zero_shot for trial in trials])
    chosen = nearest_the_mean(zero_shot)
    if chosen is None:
        raise PuddleError(f"study {settings.name!r}: no champion survived True Slush")
    trial = trials[chosen]
    design = design_from(
        decode_json(store.read(upstream["transfer"].chain(trial)[-1], CHAMPION), trial.label), trial.label
    )
    origin = (
        f"Champion of trial {trial.index} of study {settings.name}, evolved in {arm.environment.replace('_', ' ')} at "
        f"{arm.depth:g} m. It scores {zero_shot[chosen]:+.2f} m in True Slush, nearest to the mean of {len(trials)} "
        f"champions, {zero_shot.mean():+.2f} m."
    )
    return DesignSource(
        design,
        f"{settings.name}-trial-{trial.index}",
        origin,
        settings,
        arm.depth,
        _predictions(settings, upstream, store, design, trial),
        scored[trial].zero_shot,
    )


def _predictions(
    settings: Settings, upstream: Mapping[str, Results], store: Store, design: Designs, trial: TrialId
) -> tuple[float, ...] | None:
    """Simulate a trial's design under every member of the ensemble that serves it, if there is one."""
    if not settings.needs_ensemble:
        return None
    try:
        data_set = data_set_of(trial, main_data_set(settings).group)
        inputs = environments.ensemble_inputs(settings, data_set, upstream)
    except (MissingInputs, KeyError):
        return None
    files = {name: {WEIGHTS: store.read(source.manifest, WEIGHTS)} for name, source in inputs.items()}
    environment = environments.build_environment({}, "residual_slush", trial.depth, files)
    simulation = environments.simulation_spec(settings, "residual_slush")
    rollouts = environments.roll_out(simulation, Execution(settings.work.engine), environment, design)
    if not (rollouts.status == OK).all():
        return None
    return tuple(float(value) for value in rollouts.displacement[:, 0])
