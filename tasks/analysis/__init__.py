"""What a study shows: how good predictions are, whose fault a transfer gap is, and where an ensemble hallucinates.

Paper, "Results". Arrays in, arrays out. What can't be computed says why in its place: see
:class:`tasks.analysis.uncertainty.Estimate`.
"""

from tasks.analysis.attribution import Attribution, TransferMatrix, attribute, transfer_matrix
from tasks.analysis.comparison import Comparison, Contrast, SignificanceTest, compare, holm, ratio, sweep
from tasks.analysis.hallucination import (
    Disagreement,
    Exploiter,
    acceleration,
    disagreement,
    link_states,
    member_accelerations,
    rank_exploiters,
)
from tasks.analysis.luck import Luck, Reach, jittered, luck, reach
from tasks.analysis.member_error import MemberError, member_errors, phantom_thrust, thrown_links
from tasks.analysis.novelty import SPACE, Novelty, Thrown, novelty, thrown
from tasks.analysis.paper import Row, against_paper
from tasks.analysis.prediction import (
    Histograms,
    MembersRange,
    Regression,
    accuracy,
    aggregates,
    histograms,
    members,
    members_ranges,
    regress,
)
from tasks.analysis.sample import draw_over_generations, spread_evenly
from tasks.analysis.scores import EvolvedIn, Quantity, Scores
from tasks.analysis.tank import Crossing, Tank, crossings, nearest_the_mean
from tasks.analysis.uncertainty import Estimate, bootstrap, mean

__all__ = [
    "SPACE",
    "Attribution",
    "Comparison",
    "Contrast",
    "Crossing",
    "Disagreement",
    "Estimate",
    "EvolvedIn",
    "Exploiter",
    "Histograms",
    "Luck",
    "MemberError",
    "MembersRange",
    "Novelty",
    "Quantity",
    "Reach",
    "Regression",
    "Row",
    "Scores",
    "SignificanceTest",
    "Tank",
    "Thrown",
    "TransferMatrix",
    "acceleration",
    "accuracy",
    "against_paper",
    "aggregates",
    "attribute",
    "bootstrap",
    "compare",
    "crossings",
    "disagreement",
    "draw_over_generations",
    "histograms",
    "holm",
    "jittered",
    "link_states",
    "luck",
    "mean",
    "member_accelerations",
    "member_errors",
    "members",
    "members_ranges",
    "nearest_the_mean",
    "novelty",
    "phantom_thrust",
    "rank_exploiters",
    "ratio",
    "reach",
    "regress",
    "spread_evenly",
    "sweep",
    "thrown",
    "thrown_links",
    "transfer_matrix",
]
