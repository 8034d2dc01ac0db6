"""Champions tested at every depth of the grid, in True Slush."""

from dataclasses import dataclass

import numpy as np

from tasks.analysis.registry import OfTrial, StudyData, analysis, column
from tasks.design.genes import concatenate


@dataclass(frozen=True)
class TransferTest(OfTrial):
    """A champion of one depth at another; None where it diverged."""

    tested: float = column("tested at", "m", form="{:g}")
    displacement: float | None = column("displacement", "m")
    com_displacement: float | None = column("of CoM", "m", meaning="Of the centre of mass.")


@analysis(
    "transfer_tests", row=TransferTest, reads=("transfer",), answers="How far do they get at other depths?", cost=10
)
def transfer_tests(study: StudyData) -> list[TransferTest]:
    """Test every champion at every depth."""
    champions, rows = study.champions, []
    for depth in study.depths if champions else ():
        found = study.simulate(study.true_slush(depth), concatenate([champion.design for champion in champions]))
        for champion, *moved in zip(champions, found.displacement, found.com_displacement, strict=True):
            known = (float(value) if np.isfinite(value) else None for value in moved)
            rows.append(TransferTest(champion.environment, champion.depth, champion.trial, depth, *known))
    return rows
