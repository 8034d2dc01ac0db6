"""How much of what champions do where they evolved lies outside the throws that their networks learned from.

No true slush is involved, so it shows where to distrust a prediction when the truth is not known.
"""

from dataclasses import dataclass, replace

import numpy as np

from tasks.analysis.coverage import coverage, observed_states
from tasks.analysis.registry import Champion, OfTrial, StudyData, analysis, column, percent
from tasks.arrays import Float32
from tasks.design.genes import concatenate
from tasks.residual.support import deviations

_N_STATES = 2_000  # of each champion: a share is then known to 2 %


@dataclass(frozen=True)
class ChampionCoverage(OfTrial):
    """How far the states of one champion are from the throws, in all or because of one component."""

    component: str = column("component", form="{}", meaning="Of a link's state; all for its whole.")
    n: int = column("states", form="{:,}")
    share_outside: float = column("outside", form=percent, meaning="Share of states outside, chiefly because of it.")
    low: float | None = column("low", form="{:z.2f}", meaning="5th percentile of the component there.")
    high: float | None = column("high", form="{:z.2f}", meaning="95th percentile.")
    median: float = column("median distance", form="{:.2f}", meaning="Of all states from the throws, in deviations.")
    far: float = column("95 % within", form="{:.2f}")


@analysis(
    "champion_coverage",
    row=ChampionCoverage,
    reads=("collect", "train", "transfer"),
    answers="How much of what champions do lies outside the throws?",
    each="arm",
)
def champion_coverage(study: StudyData) -> list[ChampionCoverage]:
    """Compare the champions of one arm with the throws: none if they evolved without networks."""
    champions = [champion for champion in study.champions if study.home(champion).is_ensemble]
    states = {id(champion): found for champion, found in _states(study, champions) if len(found)}
    known = [champion for champion in champions if id(champion) in states]
    if not known:
        return []
    scale = deviations(np.concatenate([states[id(champion)] for champion in known]))
    rows = []
    for champion in known:
        learned, held_out = study.throws(champion)
        thrown = np.concatenate((learned.observation, held_out.observation))
        for row in coverage(states[id(champion)], thrown, scale):
            low, high = (None if np.isnan(end) else end for end in (row.low, row.high))
            who = champion.environment, champion.depth, champion.trial, row.component, row.n, row.share_outside
            rows.append(ChampionCoverage(*who, low, high, row.median, row.far))
    return rows


def _states(study: StudyData, champions: list[Champion]) -> list[tuple[Champion, Float32]]:
    """Return states of champions' links where they evolved, under every member; one simulation for each home."""
    groups: dict[int, list[Champion]] = {}
    for champion in champions:
        groups.setdefault(id(study.home(champion)), []).append(champion)
    found = []
    for own in groups.values():
        designs = concatenate([champion.design for champion in own])
        rollouts = study.simulate(study.home(own[0]), designs, trace=True)
        assert rollouts.trace is not None
        for number, champion in enumerate(own):
            rng = study.rng("coverage", champion.environment, champion.depth, champion.trial)
            of_one = replace(rollouts, trace=np.take(rollouts.trace, [number], axis=-4))
            states = observed_states(champion.design, of_one, n_settle=study.n_settle, rng=rng, n_most=_N_STATES)
            found.append((champion, states))
    return found
