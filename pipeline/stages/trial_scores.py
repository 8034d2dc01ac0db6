"""The scores of a trial's champion by name, and the file in which the stage transfer writes them.

``fitness`` is what evolution maximised where the champion evolved: μ - kσ for an ensemble. The others are displacements
of its root [m]: ``predicted`` where it evolved, for an ensemble the mean over members; ``predicted_sd``, their
deviation σ; ``zero_shot`` in the target; ``adapted`` there, with a controller that evolved there. ``zero_shot_com`` and
``adapted_com`` are those of its centre of mass. Where the objective is another than the paper's, what it scores is
beside them, such as ``zero_shot_score``. Of another engine, too, as ``mujoco.zero_shot``.

A score is None where its rollout diverged, and missing where there was none; σ is None without an ensemble.
"""

import math
from collections.abc import Mapping

from pipeline.store.encoding import decode_json, encode_json

NO_CHAMPION = "no champion: every design of the trial diverged"  # status of a trial without survivors

Scores = Mapping[str, float | None]


def encode_scores(scores: Scores | None) -> bytes:
    """Return the file of a trial's scores, where None stands for a trial without a champion."""
    if scores is None:
        return encode_json({"status": NO_CHAMPION})
    finite = {name: value if value is not None and math.isfinite(value) else None for name, value in scores.items()}
    return encode_json({"status": "ok", **finite})


def decode_scores(data: bytes, source: str) -> Scores | None:
    """Undo :func:`encode_scores`; ``source`` names the trial in messages."""
    scores = dict(decode_json(data, source))
    return None if scores.pop("status") == NO_CHAMPION else scores
