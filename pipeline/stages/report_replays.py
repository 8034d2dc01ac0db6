"""From an arm's films to what the page shows: replays, with what the instruments say of them laid over.

Part of the stage report.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from pipeline.config.settings import RESIDUAL_ENVIRONMENTS
from pipeline.report.replay import Overlay, Replay, Surroundings, at_frames, replay_of
from pipeline.stages import environments
from pipeline.stages.analyse import INSTRUMENTS, read_table
from pipeline.stages.analyses.champions import champions
from pipeline.stages.analyses.filmed_rollouts import NOBODY, Filmed, film_arm
from pipeline.stages.analyses.instruments import transitions_of
from pipeline.stages.analyses.specs import AnalysisId
from pipeline.stages.environments import SimulationSpec, members_among
from pipeline.stages.proposed_design import ANALYSED
from pipeline.workflow.identity import Arm, InputName, TrialId, deepest_first
from pipeline.workflow.stage import Execution, Files, Inputs
from tasks.analysis import acceleration, disagreement, link_states, novelty, thrown
from tasks.design import Designs
from tasks.world import ENVIRONMENTS, EnvironmentName, Medium

LAID_OVER = (
    ("disagreement", "what the members disagree about", "m/s²", 0.0),
    ("novelty", "distance from the throws", "× usual", 1.0),
)
"""Column of the instruments' links, what the page calls it, its unit, and what the darkest colour is at least: within
the usual distance a state is not new."""


def replays_of(
    simulation: SimulationSpec, trials: Sequence[TrialId], execution: Execution, inputs: Inputs
) -> list[Replay]:
    """Film the best champion of every arm, in True Slush and where it evolved, deepest first.

    Args:
        simulation: physics, rollout, and the media of True Slush and of the environments where they evolved.
        trials: trials of the arms.
        execution: the engine.
        inputs: scores, every member or none, and the instruments of the arms where there is something to lay over.
    """
    networks = members_among(inputs)
    replays = []
    for arm, own in deepest_first(trials).items():
        said = inputs.get(InputName(ANALYSED, AnalysisId(INSTRUMENTS, arm)), {})
        films = film_arm(simulation, execution, champions(own, inputs), networks)
        replays += [_replay(simulation, film, _overlays(simulation, film, said), networks) for film in films]
    return replays


def _replay(simulation: SimulationSpec, film: Filmed, overlays: tuple[Overlay, ...], networks: Inputs) -> Replay:
    champion, trial = film.champion, film.champion.trial
    style = ENVIRONMENTS[trial.environment]
    return replay_of(
        champion.design,
        film.trace[0],
        title=f"Evolved {style.evolved}, trial {trial.index}",
        environment=trial.environment,
        seen_in=_words(film),
        depth=trial.depth,
        surroundings=surroundings_in(film.world),
        n_settle=simulation.rollout.n_settle,
        time_step=simulation.physics.time_step,
        overlays=overlays,
        push=push_of(simulation, Arm(film.world, trial.depth), film.member, champion.design, film.trace, networks),
    )


def surroundings_in(environment: EnvironmentName) -> Surroundings:
    """Return what fills an environment."""
    if environment in RESIDUAL_ENVIRONMENTS:
        return "hallucinated slush"
    return {"dry_land": "air", "true_slush": "true slush"}.get(environment, "another medium")  # type: ignore[return-value]


def _words(film: Filmed) -> str:
    """Name the world of a film; both kinds of residual worlds are Residual Slush as a member has it."""
    if film.world in RESIDUAL_ENVIRONMENTS:
        return f"Residual Slush (member {film.member})"
    return ENVIRONMENTS[film.world].label


def _overlays(simulation: SimulationSpec, film: Filmed, instruments: Files) -> tuple[Overlay, ...]:
    """Read what the instruments say of the champion's links in this world; nothing where they saw another."""
    if not instruments:
        return ()
    worlds, links = read_table(instruments, "worlds"), read_table(instruments, "links")
    here = (worlds["world"] == film.world) & (worlds["trial"] == film.champion.trial.index)
    if not (here & (worlds["member"] == film.member)).any():
        return ()
    of = links["world"] == film.world
    n_links = int(links["link"].max()) + 1
    return tuple(
        Overlay(label, unit, at_frames(links[column][of].reshape(-1, n_links), simulation.rollout.n_settle), least)
        for column, label, unit, least in LAID_OVER
        if np.isfinite(links[column][of]).any()
    )


def looked_at(
    simulation: SimulationSpec,
    design: Designs,
    trace: npt.NDArray[np.floating],
    inputs: Inputs,
    *,
    held_out: float,
    seed: int,
) -> tuple[Overlay, ...]:
    """Put one rollout of any design under the instruments, as analyse does for champions.

    Args:
        simulation: physics and rollout.
        design: the one design.
        trace: (1, n_steps, n_links, 6)
        inputs: every member, and the throws.
        held_out: share of the throws that the members did not learn from.
        seed: of the study.
    """
    physics = simulation.physics
    learned, _ = transitions_of(held_out, seed, inputs)
    said = disagreement(design, trace, environments.ensemble_of(inputs), physics).magnitude[0]
    new = novelty(link_states(design, trace, physics), thrown(learned.observation, learned.throw)).novelty[0]
    return tuple(
        Overlay(label, unit, at_frames(values, simulation.rollout.n_settle), least)
        for (_, label, unit, least), values in zip(LAID_OVER, (said, new), strict=True)
        if np.isfinite(values).any()
    )


def push_of(
    simulation: SimulationSpec,
    arm: Arm,
    member: int,
    design: Designs,
    trace: npt.NDArray[np.floating],
    networks: Inputs,
) -> npt.NDArray[np.float64] | None:
    """Compute how the medium, or the member that stands for it, speeds up each link: (n_frames, n_links, 2) [m/s²].

    Args:
        simulation: physics, rollout, and the environment's medium.
        arm: the environment and its depth.
        member: whose world it is, or NOBODY's.
        design: the one design.
        trace: (1, n_steps, n_links, 6)
        networks: every member, where it is a member's world.

    Returns:
        None where nothing surrounds the links.
    """
    if member == NOBODY:
        medium: Medium | None = environments.build_environment(simulation.media, arm.environment, arm.depth, {}).medium
    else:
        name, files = list(members_among(networks).items())[member]
        medium = environments.ensemble_of({name: files})
    if medium is None:
        return None
    physics = simulation.physics
    change = acceleration(medium, link_states(design, trace, physics), physics)
    return at_frames(change[0, ..., :2], simulation.rollout.n_settle)
