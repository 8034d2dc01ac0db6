"""Replays of the best champion of each arm, with the measurements of the instruments as overlays.

Part of the stage report.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.config.settings import RESIDUAL_ENVIRONMENTS
from pipeline.report.data import arm_words
from pipeline.report.replay import Overlay, Replay, Surroundings, at_frames, replay_of
from pipeline.stages import environments
from pipeline.stages.analyses.analysis_tables import read_rows, read_table
from pipeline.stages.analyses.champions import champions
from pipeline.stages.analyses.filmed_rollouts import NO_MEMBER, Filmed, film_arm
from pipeline.stages.analyses.instruments import FilmRow, transitions_of
from pipeline.stages.analyses.specs import INSTRUMENTS
from pipeline.stages.data_sets import NetworkId
from pipeline.stages.environments import SimulationSpec, networks_among
from pipeline.stages.part import PartId
from pipeline.stages.proposed_design import ANALYSED
from pipeline.stages.report_robots import address_of, exploiters, films_of_exploiter, in_true_slush
from pipeline.workflow.identity import Arm, InputName, TrialId, deepest_first
from pipeline.workflow.stage import Execution, Files, Inputs
from tasks.analysis.hallucination import acceleration, disagreement, link_states
from tasks.analysis.novelty import novelty, thrown
from tasks.arrays import Float64, Floats
from tasks.design import Designs
from tasks.world import ENVIRONMENTS, EnvironmentName, Medium

EXPLOITERS = "Exploiters"  # group of the viewer's list
TOGETHER = "replay"  # film of two robots, without suffix: the best with residuals above the best without

_OVERLAYS = (
    ("disagreement", "disagreement of the members", "m/s²", 0.0),
    ("novelty", "distance from the throws", "× typical", 1.0),
)
"""Column of the table of links, label on the page, unit, and lower bound on the value of the darkest colour: a state
within the usual distance is not novel."""


def replays_of(
    simulation: SimulationSpec, trials: Sequence[TrialId], execution: Execution, inputs: Inputs
) -> list[Replay]:
    """Return replays of the best champion of every arm, in True Slush and where it evolved, deepest first.

    Args:
        simulation: physics, rollout, and the media of True Slush and of the environments where they evolved.
        trials: trials of the arms.
        execution: the engine.
        inputs: scores, every member or none, and the measurements of the instruments where there are some.
    """
    return [
        replay for own in deepest_first(trials).values() for replay in _best_of_arm(simulation, own, execution, inputs)
    ]


def replays_of_page(
    simulation: SimulationSpec, trials: Sequence[TrialId], execution: Execution, inputs: Inputs
) -> list[Replay]:
    """Return replays of every champion and every listed exploiter; see :func:`replays_of` for the best champions.

    Args:
        simulation: physics, rollout, and the media of all environments of the study.
        trials: trials of the arms.
        execution: the engine.
        inputs: those of the page.
    """
    networks, replays = networks_among(inputs), []
    for own in deepest_first(trials).values():
        best = _best_of_arm(simulation, own, execution, inputs)
        shown = {replay.robot for replay in best if replay.in_true_slush}
        films = in_true_slush(simulation, execution, champions(own, inputs))
        rest = [film for film in films if address_of(film.champion) not in shown]
        replays += [*best, *(_replay(simulation, film, networks, pushed=False) for film in rest)]
    seen = {(replay.robot, replay.seen_in) for replay in replays}
    for address, (row, exploiter) in exploiters(inputs, trials).items():
        for film in films_of_exploiter(simulation, execution, row, exploiter, networks):
            if (address, _words(film)) not in seen:
                words = "" if row.identity < 0 else f", generation {row.generation}, design {row.identity}"
                replay = _replay(simulation, film, networks)
                replays.append(replace(replay, title=replay.title + words, robot=address, group=EXPLOITERS))
    return replays


def _best_of_arm(
    simulation: SimulationSpec, own: Sequence[TrialId], execution: Execution, inputs: Inputs
) -> list[Replay]:
    """Return the replays of an arm that are also films."""
    networks = networks_among(inputs)
    measured = inputs.get(InputName(ANALYSED, PartId(INSTRUMENTS, own[0].arm)), {})
    films = film_arm(simulation, execution, champions(own, inputs), networks)
    replays = [_replay(simulation, film, networks, _overlays(simulation, film, measured)) for film in films]
    return [replace(replay, film=_film_name(replay)) for replay in replays]


def _film_name(replay: Replay) -> str:
    """Name the film of one robot; the store allows no dot in a name."""
    suffix = "" if replay.in_true_slush else "-at-home"
    return f"{TOGETHER}-{replay.environment}-{replay.depth:g}m".replace(".", "_") + suffix


def _replay(
    simulation: SimulationSpec,
    film: Filmed,
    networks: Inputs,
    overlays: tuple[Overlay, ...] = (),
    *,
    pushed: bool = True,
) -> Replay:
    """Return the replay of a film; the push of the slush, which takes much of a page, is optional."""
    champion, trial = film.champion, film.champion.trial
    style = ENVIRONMENTS[trial.environment]
    arm = Arm(film.seen_in, trial.depth)
    network = NetworkId(environments.data_set_among(networks, trial), film.member) if networks else None
    push = push_of(simulation, arm, film.member, champion.design, film.trace, networks, network) if pushed else None
    replay = replay_of(
        champion.design,
        film.trace[0],
        title=f"Evolved {style.evolved}, trial {trial.index}",
        environment=trial.environment,
        seen_in=_words(film),
        depth=trial.depth,
        surroundings=surroundings_in(film.seen_in),
        n_settle=simulation.rollout.n_settle,
        time_step=simulation.physics.time_step,
        overlays=overlays,
        push=push,
    )
    return replace(replay, robot=address_of(champion), group=arm_words(trial.environment, trial.depth))


def surroundings_in(environment: EnvironmentName) -> Surroundings:
    """Return what fills an environment."""
    if environment in RESIDUAL_ENVIRONMENTS:
        return "hallucinated slush"
    known: dict[str, Surroundings] = {"dry_land": "air", "true_slush": "true slush"}
    return known.get(environment, "another medium")


def _words(film: Filmed) -> str:
    """Name the environment of a film, with its member; those with networks are Residual Slush."""
    label = "Residual Slush" if film.seen_in in RESIDUAL_ENVIRONMENTS else ENVIRONMENTS[film.seen_in].label
    return label if film.member == NO_MEMBER else f"{label} (member {film.member})"


def _overlays(simulation: SimulationSpec, film: Filmed, instruments: Files) -> tuple[Overlay, ...]:
    """Read the measurements along a film; none where the instruments measured another one."""
    if not instruments:
        return ()
    films = read_rows(instruments, "films", FilmRow)
    if (film.seen_in, film.champion.trial.index, film.member) not in {
        (row.seen_in, row.trial, row.member) for row in films
    }:
        return ()
    links = read_table(instruments, "links")
    rows = links["seen_in"] == film.seen_in
    n_links = int(links["link"].max()) + 1
    return tuple(
        Overlay(label, unit, at_frames(links[column][rows].reshape(-1, n_links), simulation.rollout.n_settle), least)
        for column, label, unit, least in _OVERLAYS
        if np.isfinite(links[column][rows]).any()
    )


def looked_at(
    simulation: SimulationSpec, design: Designs, trace: Floats, inputs: Inputs, *, held_out: float, seed: int
) -> tuple[Overlay, ...]:
    """Return disagreement and novelty along one rollout of any design, where they are known.

    Args:
        simulation: physics and rollout.
        design: a single design.
        trace: (1, n_steps, n_links, 6)
        inputs: every member, and the throws.
        held_out: share of the throws that were held out.
        seed: seed of the study.
    """
    physics = simulation.physics
    learned, _ = transitions_of(held_out, seed, inputs, environments.main_data_set_among(inputs))
    magnitude = disagreement(design, trace, environments.ensemble_of(inputs), physics).magnitude[0]
    new = novelty(link_states(design, trace, physics), thrown(learned.observation, learned.throw)).novelty[0]
    return tuple(
        Overlay(label, unit, at_frames(values, simulation.rollout.n_settle), least)
        for (_, label, unit, least), values in zip(_OVERLAYS, (magnitude, new), strict=True)
        if np.isfinite(values).any()
    )


def push_of(
    simulation: SimulationSpec,
    arm: Arm,
    member: int,
    design: Designs,
    trace: Floats,
    networks: Inputs,
    network: NetworkId | None,
) -> Float64 | None:
    """Return the acceleration of each link by the medium, (n_frames, n_links, 2) [m/s²]; None where there is none.

    Args:
        simulation: physics, rollout, and the environment's medium.
        arm: the environment and its depth.
        member: number of the member of an ensemble, or NO_MEMBER.
        design: a single design.
        trace: (1, n_steps, n_links, 6)
        networks: files of the networks.
        network: the one that predicts the medium, if one does.
    """
    medium: Medium | None
    if arm.environment in RESIDUAL_ENVIRONMENTS:
        assert network is not None
        medium = environments.ensemble_of(environments.network_among(networks, network))
    else:
        environment = environments.build_environment(simulation.media, arm.environment, arm.depth, {})
        medium = environment.components[max(member, 0)].medium
    if medium is None:
        return None
    physics = simulation.physics
    change = acceleration(medium, link_states(design, trace, physics), physics)
    return at_frames(change[0, ..., :2], simulation.rollout.n_settle)
