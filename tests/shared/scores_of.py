"""Scores of made-up champions."""

from types import SimpleNamespace

import numpy as np

from pipeline.config.settings import Settings
from tasks.analysis.scores import ScoredTrial


def trials_of(zero_shot, *, adapted=None, predicted=None, n_replicates=1):
    """Return trials by arm (environment, depth) from their zero-shot displacements, and others where they are given."""
    others = {"adapted": adapted or {}, "predicted": predicted or {}}
    return [
        ScoredTrial(
            *arm,
            k,
            k % n_replicates if arm[0] not in ("true_slush", "dry_land") else 0,
            zero_shot=z,
            status="ok",
            **{name: given[arm][k] for name, given in others.items() if arm in given},
        )
        for arm, values in zero_shot.items()
        for k, z in enumerate(values)
    ]


def study_of(zero_shot, target="true_slush", **others):
    """Return what an analysis of scores reads of a study."""
    trials = trials_of(zero_shot, **others)
    rng = lambda *identity: np.random.default_rng(0)  # noqa: E731
    learners = {name: learner for name, _ in zero_shot if (learner := Settings().learner(name))}
    settings = SimpleNamespace(data_sets=(), learners=learners, assessed_depth=9.0)
    papers = target == "true_slush"
    return SimpleNamespace(trials=trials, rng=rng, settings=settings, target=target, has_papers_target=papers)


def spread(mean, sd, n):
    """Return n values with exactly this mean and sample deviation."""
    values = np.arange(n) - (n - 1) / 2
    return mean + sd * values / values.std(ddof=1) if n > 1 else np.array([mean])
