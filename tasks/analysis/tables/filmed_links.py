"""Where the networks are unreliable along the best champions' paths: what the viewer shows as colours."""

from dataclasses import dataclass

import numpy as np

from tasks.analysis.filmed import film_best
from tasks.analysis.hallucination import disagreement, link_states
from tasks.analysis.novelty import novelty, thrown
from tasks.analysis.registry import StudyData, analysis, column
from tasks.analysis.tables.transfer import environment_name


@dataclass(frozen=True)
class FilmedLink:
    """A link at one step of a film; None where its state is not finite."""

    environment: str = column("evolved in", form=environment_name)
    depth: float = column("depth", "m", form="{:g}")
    trial: int = column("trial", form="{}")
    seen_in: str = column("seen in", form=environment_name)
    step: int = column("step", form="{}")
    link: int = column("link", form="{}")
    disagreement: float | None = column("disagreement", "m/s²", form="{:.3g}", meaning="Deviation over members.")
    novelty: float | None = column(
        "novelty", form="{:.2f}", meaning="Distance from the throws; 1 is typical of a new throw."
    )


@analysis(
    "filmed_links",
    row=FilmedLink,
    reads=("collect", "train", "transfer"),
    answers="Where along their paths do the best champions leave what the networks know?",
    each="arm",
    cost=3,
)
def filmed_links(study: StudyData) -> list[FilmedLink]:
    """Measure disagreement and novelty along the films of an arm's best champion."""
    rows: list[FilmedLink] = []
    if not study.champions:
        return rows
    films = film_best(study, study.champions)
    best = films[0].champion if films else study.champions[0]
    ensemble, (learned, _) = study.ensemble(best), study.throws(best)
    index = thrown(learned.observation, learned.throw)
    for film in films:
        magnitude = disagreement(film.champion.design, film.trace, ensemble, study.physics)[0]
        new = novelty(link_states(film.champion.design, film.trace, study.physics), index)[0]
        who = film.champion.environment, film.champion.depth, film.champion.trial, film.seen_in
        for (step, link), value in np.ndenumerate(magnitude):
            pair = float(value), float(np.float32(new[step, link]))
            rows.append(FilmedLink(*who, step, link, *(v if np.isfinite(v) else None for v in pair)))
    return rows
