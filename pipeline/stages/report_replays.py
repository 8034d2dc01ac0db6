"""From an arm's films to what the page shows: replays, with what the instruments say of them laid over.

Part of the stage report.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from pipeline.config.settings import RESIDUAL_ENVIRONMENTS, EnvironmentName
from pipeline.report.replay import Overlay, Replay, Surroundings, at_frames, replay_of
from pipeline.stages import segments
from pipeline.stages.analyse import arm_label, arms_of, read_table
from pipeline.stages.analyses.champions import champions, ensemble_of
from pipeline.stages.analyses.filmed_rollouts import NOBODY, Filmed, film_arm
from pipeline.stages.analyses.instruments import transitions_of
from pipeline.workflow.stage import Files, Spec
from tasks.analysis import acceleration, disagreement, link_states, novelty, thrown
from tasks.design import Designs
from tasks.world import ENVIRONMENTS, Medium, Physics

LAID_OVER = (
    ("disagreement", "what the members disagree about", "m/s²", 0.0),
    ("novelty", "distance from the throws", "× usual", 1.0),
)
"""Column of the instruments' links, what the page calls it, its unit, and what the darkest colour is at least: within
the usual distance a state is not new."""


def replays_of(spec: Spec, execution: Spec, inputs: Mapping[str, Files]) -> list[Replay]:
    """Film the best champion of every arm, in True Slush and where it evolved, deepest first.

    Args:
        spec: physics, rollout, what True Slush and the worlds where they evolved are made of, and trials.
        execution: the engine.
        inputs: ``transfer/<trial>``, every ``member-<n>`` or none, and ``analyse/<arm>`` where there is something to
            lay over.
    """
    networks = {name: files for name, files in inputs.items() if name.startswith("member-")}
    replays = []
    for environment, depth in arms_of(spec["trials"]):
        arm = champions([row for row in spec["trials"] if tuple(row[:2]) == (environment, depth)], inputs)
        said = inputs.get(f"analyse/{arm_label(environment, depth)}", {})
        films = film_arm(spec, execution, arm, networks)
        replays += [_replay(spec, film, _overlays(spec, film, said), networks) for film in films]
    return replays


def _replay(spec: Spec, film: Filmed, overlays: tuple[Overlay, ...], networks: Mapping[str, Files]) -> Replay:
    champion, style = film.champion, ENVIRONMENTS[film.champion.environment]
    here = {**spec, "world": film.world, "depth": champion.depth}
    return replay_of(
        champion.design,
        film.trace[0],
        title=f"Evolved {style.evolved}, trial {champion.trial}",
        environment=champion.environment,
        seen_in=_words(film),
        depth=champion.depth,
        surroundings=surroundings_in(film.world),
        n_settle=spec["rollout"]["n_settle"],
        time_step=spec["physics"]["time_step"],
        overlays=overlays,
        push=push_of(here, film.member, champion.design, film.trace, networks),
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


def _overlays(spec: Spec, film: Filmed, instruments: Files) -> tuple[Overlay, ...]:
    """Read what the instruments say of the champion's links in this world; nothing where they saw another."""
    if not instruments:
        return ()
    worlds, links = read_table(instruments, "worlds"), read_table(instruments, "links")
    here = (worlds["world"] == film.world) & (worlds["trial"] == film.champion.trial)
    if not (here & (worlds["member"] == film.member)).any():
        return ()
    of = links["world"] == film.world
    n_links = int(links["link"].max()) + 1
    return tuple(
        Overlay(label, unit, at_frames(links[column][of].reshape(-1, n_links), spec["rollout"]["n_settle"]), least)
        for column, label, unit, least in LAID_OVER
        if np.isfinite(links[column][of]).any()
    )


def looked_at(
    spec: Spec, design: Designs, trace: npt.NDArray[np.floating], inputs: Mapping[str, Files]
) -> tuple[Overlay, ...]:
    """Put one rollout of any design under the instruments, as analyse does for champions.

    Args:
        spec: physics and rollout, and which of the throws the members did not learn from.
        design: the one design.
        trace: (1, n_steps, n_links, 6)
        inputs: every ``member-<n>``, and the throws.
    """
    physics = Physics.model_validate(spec["physics"])
    learned, _ = transitions_of(spec, inputs)
    said = disagreement(design, trace, ensemble_of(inputs), physics).magnitude[0]
    new = novelty(link_states(design, trace, physics), thrown(learned.observation, learned.throw)).novelty[0]
    return tuple(
        Overlay(label, unit, at_frames(values, spec["rollout"]["n_settle"]), least)
        for (_, label, unit, least), values in zip(LAID_OVER, (said, new), strict=True)
        if np.isfinite(values).any()
    )


def push_of(
    spec: Spec, member: int, design: Designs, trace: npt.NDArray[np.floating], networks: Mapping[str, Files]
) -> npt.NDArray[np.float64] | None:
    """Compute how the medium, or the member that stands for it, speeds up each link: (n_frames, n_links, 2) [m/s²].

    Args:
        spec: physics, rollout, and the world: its name, its depth, and what it is made of.
        member: whose world it is, or NOBODY's.
        design: the one design.
        trace: (1, n_steps, n_links, 6)
        networks: every ``member-<n>``, where it is a member's world.

    Returns:
        None where nothing surrounds the links.
    """
    if member == NOBODY:
        medium: Medium | None = segments.world_of(spec, {}).medium
    else:
        name = sorted(name for name in networks if name.startswith("member-"))[member]
        medium = ensemble_of({name: networks[name]})
    if medium is None:
        return None
    physics = Physics.model_validate(spec["physics"])
    change = acceleration(medium, link_states(design, trace, physics), physics)
    return at_frames(change[0, ..., :2], spec["rollout"]["n_settle"])
