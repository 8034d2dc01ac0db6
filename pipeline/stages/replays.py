"""Replays of champions: every one in True Slush, and the best of each arm where it evolved, too."""

import contextlib
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.config.settings import RESIDUAL_ENVIRONMENTS, Settings
from pipeline.report.page import robot_address
from pipeline.report.replay import Overlay, Replay, Surroundings, at_frames, replay_of
from pipeline.stages import environments
from pipeline.stages.data_sets import NetworkId
from pipeline.stages.environments import SimulationSpec
from pipeline.stages.study_data import StudyFiles
from pipeline.workflow.identity import Arm, arms_of
from tasks.analysis.filmed import NO_MEMBER, Filmed, film_best, film_in_true_slush
from tasks.analysis.hallucination import acceleration, disagreement, link_states
from tasks.analysis.registry import Champion
from tasks.arrays import Float64, Floats
from tasks.design import Designs
from tasks.residual.ensemble import WeightsError
from tasks.simulation import OK, simulate
from tasks.world import ENVIRONMENTS, DryLand, EnsembleMedium, EnvironmentName, Medium

_MOST_SECONDS_IN_TANK = 60.0  # limit on the replays of the tank [s]


def arms_with_champions(study: StudyFiles) -> list[list[Champion]]:
    """Return the champions of each arm that has some, the deepest first."""
    by_arm = {(arm.environment, arm.depth): list[Champion]() for arm in arms_of(study.spec.trials)}
    for champion in study.champions:
        by_arm[champion.environment, champion.depth].append(champion)
    return sorted((own for own in by_arm.values() if own), key=lambda own: -own[0].depth)


def replays_of(study: StudyFiles) -> list[Replay]:
    """Return replays of every champion in True Slush, the best of each arm first, and also where it evolved."""
    replays: list[Replay] = []
    for own in arms_with_champions(study):
        replays += (best := _best_of(study, own))
        filmed = {replay.robot for replay in best if replay.in_true_slush}
        rest = [champion for champion in own if _address(champion) not in filmed]
        others = film_in_true_slush(study, sorted(rest, key=lambda champion: -champion.zero_shot))
        replays += [_replay(study, film) for film in others]
    return replays


def best_replays(study: StudyFiles) -> list[Replay]:
    """Return replays in True Slush of the best champion of every arm, for the film of the first screen."""
    best = (replay for own in arms_with_champions(study) for replay in _best_of(study, own))
    return [replay for replay in best if replay.in_true_slush]


def _best_of(study: StudyFiles, own: list[Champion]) -> list[Replay]:
    """Return replays of an arm's best champion, with the push of the slush and where the members disagree."""
    if own[0].environment in RESIDUAL_ENVIRONMENTS and not study.has_networks:
        return []
    scored = np.array([champion.zero_shot for champion in own])
    mean = float(np.nanmean(scored)) if np.isfinite(scored).any() else np.nan
    replays = []
    for film in film_best(study, own):
        if np.isfinite(film.trace).all():
            simulation, design = study.spec.simulation, film.champion.design
            medium = None
            if film.seen_in in RESIDUAL_ENVIRONMENTS:
                own_network = NetworkId(study.data_set(film.champion), film.member)
                medium = environments.ensemble_of({own_network: study.networks[own_network]})
            arm = Arm(film.seen_in, film.champion.depth)
            push = push_of(simulation, arm, film.member, design, film.trace, medium)
            overlays: tuple[Overlay, ...] = ()
            with contextlib.suppress(WeightsError):  # the stages that evolve under such networks have failed and say so
                if study.networks:
                    overlays = doubts(simulation, design, film.trace, study.ensemble(film.champion))
            plain = _replay(study, film)
            replays.append(replace(plain, push=push, overlays=overlays, best=True, arm_mean=mean))
    return replays


def _address(champion: Champion) -> str:
    return robot_address(champion.environment, champion.depth, champion.trial)


def _replay(study: StudyFiles, film: Filmed) -> Replay:
    champion = film.champion
    style, simulation = ENVIRONMENTS[champion.environment], study.spec.simulation
    label = "Residual Slush" if film.seen_in in RESIDUAL_ENVIRONMENTS else ENVIRONMENTS[film.seen_in].label
    replay = replay_of(
        champion.design,
        film.trace[0],
        title=f"{style.label}, trial {champion.trial}",
        environment=champion.environment,
        seen_in=label if film.member == NO_MEMBER else f"{label} (member {film.member})",
        depth=champion.depth,
        surroundings=surroundings_in(film.seen_in),
        n_settle=study.n_settle,
        time_step=simulation.physics.time_step,
    )
    return replace(replay, robot=_address(champion), group=f"{style.label}, {champion.depth:g} m")


def surroundings_in(environment: EnvironmentName) -> Surroundings:
    """Return what fills an environment."""
    if environment in RESIDUAL_ENVIRONMENTS:
        return "hallucinated slush"
    known: dict[str, Surroundings] = {"dry_land": "air", "true_slush": "true slush"}
    return known.get(environment, "another medium")


def doubts(simulation: SimulationSpec, design: Designs, trace: Floats, ensemble: EnsembleMedium) -> tuple[Overlay, ...]:
    """Return how an ensemble's members disagree along one rollout; none where there is a single member.

    Args:
        simulation: physics and rollout.
        design: a single design.
        trace: (1, n_steps, n_links, 6)
        ensemble: the members.
    """
    of_links = disagreement(design, trace, ensemble, simulation.physics)[0]
    values = at_frames(of_links, simulation.rollout.n_settle)
    return (Overlay("disagreement of the members", "m/s²", values),) if np.isfinite(values).any() else ()


def push_of(
    simulation: SimulationSpec, arm: Arm, member: int, design: Designs, trace: Floats, learned: Medium | None
) -> Float64 | None:
    """Return the acceleration of each link by the medium, (n_frames, n_links, 2) [m/s²]; None where there is none.

    Args:
        simulation: physics, rollout, and the environment's medium.
        arm: the environment and its depth.
        member: number of the member of an ensemble, or NO_MEMBER.
        design: a single design.
        trace: (1, n_steps, n_links, 6)
        learned: what the member predicts, in an environment of networks.
    """
    medium = learned
    if arm.environment not in RESIDUAL_ENVIRONMENTS:
        environment = environments.build_environment(simulation.media, arm.environment, arm.depth, {})
        medium = environment.components[max(member, 0)].medium
    if medium is None:
        return None
    change = acceleration(medium, link_states(design, trace, simulation.physics), simulation.physics)
    return at_frames(change[0, ..., :2], simulation.rollout.n_settle)


def tank_replays(settings: Settings, champion: Champion, engine: Any) -> list[Replay]:
    """Return replays of a proposed champion in the tank and on its dry floor, without those that diverged."""
    assert settings.tank is not None
    tank, n_settle, time_step = settings.tank, settings.rollout.n_settle, settings.physics.time_step
    replays = []
    media = environments.media_of(settings, "true_slush")
    for surrounding, words in (
        (environments.true_slush(media, tank.simulated_depth), "the tank"),
        (DryLand(depth=0.0), "the drained tank"),
    ):
        rollouts = simulate(
            champion.design,
            surrounding,
            n_settle=n_settle,
            n_measure=min(tank.n_steps(time_step), round(_MOST_SECONDS_IN_TANK / time_step)),
            engine=engine,
            trace=True,
            physics=settings.physics,
        )
        if rollouts.status[0] == OK:
            assert rollouts.trace is not None
            evolved = ENVIRONMENTS[champion.environment].evolved
            replays.append(
                replay_of(
                    champion.design,
                    rollouts.trace[0],
                    title=f"To build: evolved {evolved}, trial {champion.trial}, in {words}",
                    environment="",
                    seen_in=words,
                    depth=round(surrounding.depth, 2),
                    surroundings="air" if surrounding.medium is None else "true slush",
                    n_settle=n_settle,
                    time_step=time_step,
                )
            )
    return replays
