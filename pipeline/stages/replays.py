"""Replays of champions: every one in the target, the best of each arm and overrated ones where they evolved, too."""

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from pipeline.report.page import robot_address
from pipeline.report.palette import looks_of
from pipeline.report.replay import Replay, at_frames, replay_of, shown_trace
from pipeline.stages.environments import SimulationSpec
from pipeline.stages.reader import StudyReader
from tasks.analysis.hallucination import disagreement_along
from tasks.analysis.scores import Champion, by_arm
from tasks.design import Designs
from tasks.evolution.map_elites import CELL, measure_bodies
from tasks.residual import arm_kind
from tasks.simulation import Rollouts
from tasks.world import EnsembleMedium, Environment, EnvironmentName
from tasks.world.registry import ArmKind


def replays_of(study: StudyReader, overrated: Collection[tuple[str, float, int]] = ()) -> list[Replay]:
    """Return replays of every champion in the target, the best of each arm first.

    The best and those ``overrated``, by their keys, also move where they evolved.
    """
    replays: list[Replay] = []
    for champions in _arms(study):
        best = _best_of(study, champions)
        filmed = {replay.robot for replay in best if replay.in_target}
        known = [champion for champion in champions if np.isfinite(champion.zero_shot)]
        known.sort(key=lambda champion: -champion.zero_shot)
        others = [champion for champion in known if robot_address(*champion.key) not in filmed]
        replays += best
        for champion in others:
            replays += _in_both(study, champion) if champion.key in overrated else _at_target(study, champion)
    return replays


def elite_replays(study: StudyReader) -> list[tuple[Designs, Replay]]:
    """Return the fittest elite of each cell of the deepest archives of the target, and its replay there."""
    depth = max(trial.depth for trial in study.spec.trials)
    fittest: dict[tuple[int, int], Champion] = {}
    for (environment, at, trial), population in study.populations.items():
        if (environment, at) != (study.target, depth):
            continue
        for i, cell in enumerate(map(tuple, population.extra[CELL].tolist())):
            fitness = float(population.fitness[i])
            if cell not in fittest or fitness > fittest[cell].fitness:
                design = population.designs[i]
                fittest[cell] = Champion(environment, depth, trial, 0, fitness, fitness, design=design)
    replays = []
    for cell, elite in sorted(fittest.items()):
        for replay in _at_target(study, elite):
            length, size = measure_bodies(elite.design)[0]
            address = f"elite-{cell[0]}-{cell[1]}"
            title = f"{length:.1f} m long, links of {size:.1f} m, trial {elite.trial}"
            shown = replace(replay, title=title, robot=address, group=f"Elites, {depth:g} m", in_target=False)
            replays.append((elite.design, shown))
    return replays


def best_replays(study: StudyReader) -> list[Replay]:
    """Return replays in the target of the best champion of every arm, for the film of the first screen."""
    return [replay for champions in _arms(study) for replay in _best_of(study, champions) if replay.in_target]


def _arms(study: StudyReader) -> list[list[Champion]]:
    """Return the champions of each arm that has some, the deepest first."""
    return sorted(by_arm(study.champions).values(), key=lambda champions: -champions[0].depth)


def _best_of(study: StudyReader, champions: list[Champion]) -> list[Replay]:
    """Return replays of an arm's best champion, with how much the members disagree.

    It is the best zero-shot, or the best where it evolved if none survives the target.
    """
    if arm_kind(champions[0].environment).learned and not study.has_networks:
        return []
    scored = np.array([champion.zero_shot for champion in champions])
    survives = bool(np.isfinite(scored).any())
    best = champions[int(np.nanargmax(scored if survives else [champion.fitness for champion in champions]))]
    mean = float(np.nanmean(scored)) if survives else np.nan
    return [replace(replay, best=True, arm_mean=mean) for replay in _in_both(study, best)]


def _in_both(study: StudyReader, champion: Champion) -> list[Replay]:
    """Return a champion's replays in the target, if it survives there, and where it evolved, with disagreement."""
    ensemble = study.ensemble(champion) if study.networks else None
    replays = _at_target(study, champion, ensemble) if np.isfinite(champion.zero_shot) else []
    if champion.environment != study.target:
        replays += _replay(study, champion, champion.environment, study.home(champion), ensemble)
    return replays


def _at_target(study: StudyReader, champion: Champion, ensemble: EnsembleMedium | None = None) -> list[Replay]:
    return _replay(study, champion, study.target, study.at_target(champion.depth), ensemble)


def _replay(
    study: StudyReader,
    champion: Champion,
    seen_in: EnvironmentName,
    environment: Environment,
    ensemble: EnsembleMedium | None,
) -> list[Replay]:
    """Return a champion's replay in an environment; none if it diverged there."""
    learners, arms = study.settings.learners, (trial.environment for trial in study.spec.trials)
    looks = looks_of(arms, study.target, learners)
    label = looks[champion.environment].label
    replay = replay_in(
        champion.design,
        study.simulate(environment, champion.design, trace=True),
        arm_kind(seen_in, learners),
        environment,
        study.spec.simulation,
        title=f"{label}, trial {champion.trial}",
        ensemble=ensemble,
        number=study.member(champion),
    )
    if replay is None:
        return []
    shown = replace(
        replay,
        environment=champion.environment,
        color=looks[champion.environment].color,
        robot=robot_address(*champion.key),
        group=f"{label}, {champion.depth:g} m",
        in_target=seen_in == study.target,
        score=champion.zero_shot,
    )
    return [shown]


def replay_in(
    design: Designs,
    rollouts: Rollouts,
    kind: ArmKind,
    environment: Environment,
    simulation: SimulationSpec,
    *,
    title: str,
    ensemble: EnsembleMedium | None,
    number: int | None = None,
) -> Replay | None:
    """Return the replay of a design in an environment, in an ensemble that of the median member; None if it diverged.

    ``rollouts`` have its trace there, and ``number`` is the network's in its data set, where it is not its place in the
    ensemble, whose members' disagreement is shown.
    """
    physics, n_settle = simulation.physics, simulation.rollout.n_settle
    trace, member = shown_trace(rollouts, environment)
    if not np.isfinite(trace).all():
        return None
    doubts = None
    if ensemble is not None and ensemble.n_members > 1:
        doubts = at_frames(disagreement_along(design, trace[None], ensemble, physics)[0], n_settle)
    replay = replay_of(
        design,
        trace,
        environment,
        title=title,
        seen_in=kind.label if member is None else f"{kind.label} (member {member if number is None else number})",
        n_settle=n_settle,
        hallucinated=kind.learned,
        physics=physics,
    )
    return replace(replay, command=kind.name if member is None or number is None else "", disagreement=doubts)
