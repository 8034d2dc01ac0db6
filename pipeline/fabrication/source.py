"""Which design a kit is of: a file, or the champion of a study that the paper would have built."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.fabrication.bench import MemberPredictions
from pipeline.stages import STAGES, environments
from pipeline.stages.environments import WEIGHTS
from pipeline.stages.transfer import CHAMPION, read_scores
from pipeline.store.design_file import design_from
from pipeline.store.encoding import decode_json
from pipeline.store.store import Store
from pipeline.workflow.graph import survey
from pipeline.workflow.identity import TrialId
from pipeline.workflow.stage import Execution, MissingInputs, Results
from tasks.analysis.tank import nearest_the_mean
from tasks.design import Designs
from tasks.simulation import OK


@dataclass(frozen=True, eq=False)
class DesignSource:
    """A design and where it comes from."""

    design: Designs
    name: str
    origin: str
    """In words."""
    settings: Settings
    """Of the study, or those that a design file is simulated under."""
    depth: float
    """Where it is simulated [m]."""
    members: MemberPredictions | None
    true_slush: float | None = None
    """What the study scored it in True Slush [m of simulation], if it did."""


def proposed(settings: Settings, store: Store) -> DesignSource:
    """Take the champion that :func:`_proposed` takes, of a store from which nothing is removed meanwhile."""
    with store.lock_to_read():
        return _proposed(settings, store)


def _proposed(settings: Settings, store: Store) -> DesignSource:
    """Take the champion nearest the mean True Slush score of a study's trials. Paper, "Physical Validation".

    Of the study's arms, Residual Slush comes first, and its deepest depth.

    Raises:
        PuddleError: no champion has been scored, or none survived, or something of the study is damaged.
    """
    damage: list[str] = []
    upstream = survey(settings, STAGES, store, say=damage.append)
    if damage:  # a trial would be missing from the mean, and another champion be the nearest
        raise PuddleError(damage[0])
    rows = [row for row in read_scores(settings, upstream["transfer"], store) if row.get("zero_shot") is not None]
    if not rows:
        raise PuddleError(f"study {settings.name!r}: no champion is scored in True Slush yet; `puddle study` does that")
    arms = sorted({(row["environment"], row["depth"]) for row in rows}, key=lambda a: (a[0] != "residual_slush", -a[1]))
    environment, depth = arms[0]
    arm = [row for row in rows if (row["environment"], row["depth"]) == (environment, depth)]
    scores = np.array([row["zero_shot"] for row in arm])
    chosen = nearest_the_mean(scores)
    if chosen is None:
        raise PuddleError(f"study {settings.name!r}: no champion survived True Slush")
    row = arm[chosen]
    trial = TrialId("transfer", environment, depth, row["trial"])
    design = design_from(
        decode_json(store.read(upstream["transfer"].chain(trial)[-1], CHAMPION), trial.label), trial.label
    )
    origin = (
        f"The champion of trial {row['trial']} of study {settings.name}, evolved in "
        f"{environment.replace('_', ' ')} of {depth:g} m: it gets {row['zero_shot']:+.2f} m in True Slush, the "
        f"nearest to the mean of {len(arm)} champions, {scores.mean():+.2f} m."
    )
    return DesignSource(
        design,
        f"{settings.name}-trial-{row['trial']}",
        origin,
        settings,
        depth,
        _members(settings, upstream, store, design, depth),
        row["zero_shot"],
    )


def _members(
    settings: Settings, upstream: Mapping[str, Results], store: Store, design: Designs, depth: float
) -> MemberPredictions | None:
    """Simulate a design under every member of the study's ensemble, where there is one."""
    try:
        inputs = environments.member_inputs(settings, "residual_slush", 0, upstream)
    except (MissingInputs, KeyError):
        return None
    files = {name: {WEIGHTS: store.read(source.manifest, WEIGHTS)} for name, source in inputs.items()}
    environment = environments.build_environment({}, "residual_slush", depth, files)
    simulation = environments.simulation_spec(settings, "residual_slush")
    rollouts = environments.roll_out(simulation, Execution(settings.work.engine), environment, design)
    if not (rollouts.status == OK).all():
        return None
    return MemberPredictions(tuple(float(value) for value in rollouts.displacement[:, 0]))
