"""The robot of a study to build: the champion that the paper's rule selects."""

import numpy as np

from pipeline.bench.fabrication.source import DesignSource, as_built
from pipeline.errors import PuddleError
from pipeline.results.recorded_study import Study
from pipeline.stages import environments
from pipeline.stages.data_sets import networks_of
from pipeline.stages.train import MOST_ERROR, TRAIN, WHOLE_ERROR
from pipeline.workflow.identity import TrialId
from pipeline.workflow.stage import MissingInputs
from tasks.analysis.scores import by_arm
from tasks.analysis.tank import nearest_the_mean
from tasks.design import Designs
from tasks.residual import arm_kind, in_order
from tasks.simulation import OK
from tasks.world import EnvironmentName


def check_errors(study: Study) -> None:
    """Raise PuddleError if the networks of a study predict tracked throws badly that they have not seen."""
    error = TRAIN.summarise(study.settings, study.upstream, study.store).metrics.get(WHOLE_ERROR, 0.0)
    if not error <= MOST_ERROR:
        raise PuddleError(
            f"study {study.name!r}: networks err by {error:.2f} of the way on throws that were held out, expected at "
            f"most {MOST_ERROR:g}: `puddle collect {study.name}` says why; --despite-errors makes the kit"
        )


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
    arms = by_arm(champions)
    order = [*_ensembles(study), *in_order(environment for environment, _ in arms)]
    environment, depth = min(arms, key=lambda arm: (order.index(arm[0]), -arm[1]))
    rows = arms[environment, depth]
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
    """Simulate a robot as built under every member of its trial's own ensemble, or of the study's first, if any."""
    ensembles = _ensembles(study)
    if not ensembles:
        return None
    try:
        evolved, physics = environment if environment in ensembles else ensembles[0], as_built(study.settings.physics)
        rollouts = study.simulate(design, evolved, depth=depth, trial=trial, physics=physics)
    except MissingInputs:
        return None
    return tuple(rollouts.displacement[:, 0].tolist()) if (rollouts.status == OK).all() else None
