"""The paper's results as data: its numbers, its statements about t tests, and how close counts as agreement."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from tasks.analysis.scores import ScoredArm
from tasks.world.slush import PAPERS_TARGET

Figure = Literal["r", "slope"]  # of a regression: Pearson's R, or the slope of true on predicted
Claim = Literal["less", "greater", "no difference"]

BEST: ScoredArm = (PAPERS_TARGET, "zero_shot")  # designs that evolved there, E: the upper bound
DEPTH = 9.0  # depth of the paper's prediction accuracy and of Fig. 4A [m]
N_EVALUATED = 1_000 * 64  # designs evaluated in each trial: "Evolution"
N_TRIALS = 10  # trials of each environment at each depth: "Evolution"
N_ASSESSED = 2 * N_TRIALS  # trials that the designs of the prediction accuracy come from: "Prediction Accuracy"
NEGLIGIBLE = 0.2  # share of the displacement of designs evolved in True Slush: smaller differences count as none
NEGLIGIBLE_RATIO = 0.15  # the same of ratios of displacements
NEGLIGIBLE_FIGURE: Mapping[Figure, float] = {"r": 0.15, "slope": 0.25}  # the same of figures of a regression
SIGNIFICANT, INSIGNIFICANT = 1e-4, 0.01  # the paper's two thresholds: p below the first, p above the second

MEANS: Mapping[ScoredArm, tuple[float, str]] = {
    ("true_slush", "zero_shot"): (13.6, '"mean displacement 13.6 m", Evolution'),
    ("dry_land", "zero_shot"): (-0.8, '"mean -0.8 m", Evolution'),
    ("dry_land", "adapted"): (4.8, '"increases from -0.8 to 4.8 m", Evolution'),
}
"""Mean displacement in the target at 9 m [m]."""

RATIOS: Mapping[ScoredArm, tuple[float, str]] = {
    ("dry_land", "adapted"): (0.35, '"still only achieves 35% of mean fitness", Evolution'),
    ("residual_slush", "zero_shot"): (0.67, '"recover 67% … with their evolved controllers", Evolution'),
    ("residual_slush", "adapted"): (0.87, '"and 87% with controller adaptation", Evolution'),
}
"""Mean displacement divided by that of designs that evolved in True Slush, at 9 m."""

AGGREGATES: Mapping[tuple[str, Figure], tuple[float, str]] = {
    ("mean", "r"): (0.77, '"a correlation coefficient of 0.77", Fig. 3'),
    ("mean", "slope"): (1.26, '"and a slope of 1.26", Fig. 3'),
    ("mean - 1 sd", "r"): (0.60, '"a slightly reduced correlation coefficient of 0.6", Fig. 3'),
    ("mean - 1 sd", "slope"): (0.99, '"a nearly ideal regression slope of 0.99", Fig. 3'),
}
"""Figures of aggregates of the eight members."""


@dataclass(frozen=True)
class Statement:
    """A statement of the paper about a t test."""

    a: ScoredArm
    b: ScoredArm
    claim: Claim  # whether a is less or greater than b
    depths: tuple[float, ...]  # [m]
    source: str


_DRY_LAND: ScoredArm = ("dry_land", "adapted")
_RESIDUAL: ScoredArm = ("residual_slush", "adapted")
_DEEP = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, DEPTH)
_SHALLOW = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
_SAME_AT_50_CM = '"insignificant (p > 0.01) difference between Dry Land designs and True Slush for 0.5m", Evolution'
_BELOW_BOTH = '"significantly under-performed both those evolved in Residual Slush and …", Evolution'
_SAME_TO_3_M = '"insignificantly different … up until 3m of slush (p > 0.01)", Evolution'
_ZERO_SHOT = '"significantly more performant … (Student\'s t-test, p < 0.0001; n=10)", Evolution'

STATEMENTS = (
    Statement(_DRY_LAND, BEST, "no difference", (0.5,), _SAME_AT_50_CM),
    Statement(_DRY_LAND, BEST, "less", _DEEP, '"p < 0.0001 for all slush depths > 0.5m", Evolution'),
    Statement(_DRY_LAND, _RESIDUAL, "less", _DEEP, _BELOW_BOTH),
    Statement(_RESIDUAL, BEST, "no difference", _SHALLOW, _SAME_TO_3_M),
    Statement(("residual_slush", "zero_shot"), _DRY_LAND, "greater", (DEPTH,), _ZERO_SHOT),
)
"""For the sweep over depths the paper does not name the controllers; its Fig. 4B shows the adapted ones."""
