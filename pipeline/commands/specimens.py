"""Specimens: small pieces of a study's own kind, for rates.py to time and for sizes.py to weigh."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from pipeline.config.settings import Settings
from pipeline.report import replay_of
from pipeline.report.replay import STEPS_PER_SECOND, Replay
from pipeline.stages.environments import media_of, true_medium
from tasks.design import random_designs
from tasks.residual import OBSERVATION, STATE, Architecture, Transitions, initial_states, simulate_throws
from tasks.simulation import simulate
from tasks.world import DryLand

if TYPE_CHECKING:
    from tasks.residual.ensemble import Ensemble

N_FEW_THROWS = 8


def few_throws(settings: Settings) -> Transitions:
    """Simulate N_FEW_THROWS of the study's throws."""
    throws = settings.throws.model_copy(update={"n_throws": N_FEW_THROWS})
    starts = initial_states(throws, np.random.default_rng(0))
    return simulate_throws(starts, throws.n_steps, true_medium(media_of(settings, "true_slush")), settings.physics)


def layers_of(network: Architecture, *, n_out: int = len(STATE)) -> list[tuple[int, int]]:
    """List (n_in, n_out) of a network's layers, which is trained on a whole residual; of one only part may be kept."""
    return list(pairwise([len(OBSERVATION), *[network.width] * network.hidden_layers, n_out]))


def untrained_ensemble(settings: Settings, n_members: int) -> Ensemble:
    """Make networks of the right size that change velocities by about a millimetre per second."""
    from tasks.residual.ensemble import N_OUT, Ensemble

    rng = np.random.default_rng(0)
    layers = layers_of(settings.network, n_out=N_OUT)
    scales = [1.0] * settings.network.hidden_layers + [1e-3]
    return Ensemble(
        weights=tuple(
            (scale * rng.normal(size=(n_members, n_in, n_out)) / np.sqrt(n_in)).astype(np.float32)
            for (n_in, n_out), scale in zip(layers, scales, strict=True)
        ),
        biases=tuple(np.zeros((n_members, n_out), np.float32) for _, n_out in layers),
    )


def short_film(settings: Settings) -> Replay:
    """Film a random design for a second."""
    design = random_designs(1, np.random.default_rng(0))
    rollouts = simulate(
        design, DryLand(0.0), n_settle=0, n_measure=STEPS_PER_SECOND, engine=settings.work.engine, trace=True
    )
    assert rollouts.trace is not None
    return replay_of(
        design,
        rollouts.trace[0],
        title="a film",
        environment="dry_land",
        seen_in="Dry Land",
        depth=0.0,
        surroundings="air",
        n_settle=0,
    )
