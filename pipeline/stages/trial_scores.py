"""The scores of a trial's champion, and the file in which the stage transfer writes them for later stages."""

import math
from dataclasses import dataclass
from typing import Any

from pipeline.stages.data_sets import replicate_of
from pipeline.store.encoding import decode_json, encode_json
from pipeline.workflow.identity import TrialId
from pipeline.workflow.stage import Files
from tasks.analysis.scores import ScoredTrial

SCORE = "score.json"  # name of the file
NO_CHAMPION = "no champion: every design of the trial diverged"  # status of a trial without survivors
OK_STATUS = "ok"  # status of a trial with a champion


@dataclass(frozen=True)
class TrialScores:
    """How far a trial's champion gets where it evolved and in the target [m]; NaN where its rollout diverged."""

    fitness: float  # where it evolved, in the objective's unit: μ - kσ for an ensemble
    predicted: float  # displacement of its root where it evolved: the mean over members for an ensemble, μ
    predicted_sd: float | None  # its standard deviation over members, σ; None without an ensemble
    zero_shot: float  # displacement of its root in the target
    zero_shot_com: float  # displacement of its centre of mass in the target
    adapted: float | None = None  # of its root with a controller that evolved there; None if not adapted
    adapted_com: float | None = None  # displacement of its centre of mass, likewise
    predicted_score: float | None = None  # these four are in the objective's unit; None where it is displacement
    predicted_sd_score: float | None = None
    zero_shot_score: float | None = None
    adapted_score: float | None = None

    def by_name(self) -> dict[str, float | None]:
        """Return every score; None where there is none or its rollout diverged."""
        known: dict[str, float | None] = vars(self)
        return {name: value if value is not None and math.isfinite(value) else None for name, value in known.items()}


def encode_scores(scores: TrialScores | None) -> bytes:
    """Return the file of a trial's scores, where None stands for a trial without a champion.

    A score is null where its rollout diverged, and left out where there was none; σ is null without an ensemble.
    """
    if scores is None:
        return encode_json({"status": NO_CHAMPION})
    known = scores.by_name().items()
    written = {name: value for name, value in known if getattr(scores, name) is not None or name == "predicted_sd"}
    return encode_json({"status": OK_STATUS, **written})


def decode_scores(data: bytes, source: str) -> TrialScores | None:
    """Undo :func:`encode_scores`; ``source`` names the trial in messages."""
    read = decode_json(data, source)
    if read.pop("status") == NO_CHAMPION:
        return None
    diverged = {name: math.nan for name, value in read.items() if value is None and name != "predicted_sd"}
    return TrialScores(**read | diverged)


def scored_trial(trial: TrialId, files: Files | None, displacement: bool = False) -> ScoredTrial:
    """Return what is known of a trial's champion, from the files of the stage transfer; None if it is not done.

    It is what the study's objective scores, or ``displacement`` in any case.
    """
    identity = trial.environment, trial.depth, trial.index, replicate_of(trial)
    if files is None:
        return ScoredTrial(*identity)
    scores = decode_scores(files[SCORE], trial.label)
    if scores is None:
        return ScoredTrial(*identity, status="no champion")
    suffix = "" if displacement or scores.predicted_score is None else "_score"
    found = {name: getattr(scores, name + suffix) for name in ("predicted", "predicted_sd", "zero_shot", "adapted")}
    known: dict[str, Any] = {name: math.nan if value is None else value for name, value in found.items()}
    return ScoredTrial(*identity, scores.fitness, status="ok", **known)
