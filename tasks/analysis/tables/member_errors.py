"""Errors of each member along champions in True Slush, by speed and immersion of a link."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tasks.analysis.filmed import best_of
from tasks.analysis.hallucination import acceleration, link_states, member_accelerations
from tasks.analysis.registry import StudyData, analysis, column
from tasks.analysis.tables.transfer import environment_name
from tasks.design.genes import concatenate
from tasks.residual.error_report import BANDS
from tasks.world import EnsembleMedium, LinkStates, Medium, Physics
from tasks.world.slush import submerged_part

COMPONENTS = ("vx", "vy", "omega")  # velocities that a medium changes [m/s, m/s, rad/s]
_FULLY_SUBMERGED = 1 - 1e-6  # least area below the surface of a submerged link [m²], which has 1 m² up to rounding


@dataclass(frozen=True)
class MemberError:
    """The error of predicted accelerations in one band; None where no state is in it."""

    environment: str = column("evolved in", form=environment_name, meaning="Of the champions.")
    depth: float = column("depth", "m", form="{:g}")
    member: int = column("member", form="{}")
    component: str = column("component", form="{}")
    band: str = column("speed", "m/s", form="{}", meaning="Band of the link's speed.")
    immersion: str = column("immersion", form="{}", meaning="Part of the link below the surface.")
    n_rows: int = column("states", form="{:,}")
    bias: float | None = column("bias", "m/s² or rad/s²", form="{:z.3g}")
    rmse: float | None = column("RMSE", "m/s² or rad/s²", form="{:.3g}")
    rms_true: float | None = column("truth", "m/s² or rad/s²", form="{:.3g}", meaning="Error of predicting zero.")


@analysis(
    "member_errors",
    row=MemberError,
    reads=("train", "transfer"),
    answers="How wrong is each network, by the speed and immersion of a link?",
    each="arm",
)
def member_errors(study: StudyData) -> list[MemberError]:
    """Compare the members that serve an arm with the true medium."""
    champions, physics = study.champions, study.physics
    if not champions:
        return []
    designs, depth = concatenate([champion.design for champion in champions]), champions[0].depth
    rollouts = study.simulate(study.true_slush(depth), designs, trace=True)
    assert rollouts.trace is not None
    links, ensemble = link_states(designs, rollouts.trace, physics), study.ensemble(best_of(champions))
    environment = champions[0].environment
    return [MemberError(environment, depth, *row) for row in errors(ensemble, study.true_medium(), links, physics)]


_Row = tuple[int, str, str, str, int, float | None, float | None, float | None]


def errors(ensemble: EnsembleMedium, medium: Medium, links: LinkStates, physics: Physics) -> Iterator[_Row]:
    """Yield the errors of every member on link states; states that are not finite are left out.

    Args:
        ensemble: n_members members.
        medium: the true medium, such as Slush.
        links: link states of shape (...), such as those of champions.
        physics: the base simulator's constants.
    """
    true = acceleration(medium, links, physics).reshape(-1, 3)
    error = member_accelerations(ensemble, links, physics).reshape(ensemble.n_members, -1, 3) - true
    known = np.isfinite(true).all(axis=1) & np.isfinite(error).all(axis=(0, 2))
    speed = np.hypot(links.vx, links.vy).ravel()
    wet = submerged_part(links.length_scale, links.y, links.cos, links.sin)[0].ravel()
    partly, submerged = (wet > 0) & (wet < _FULLY_SUBMERGED), wet >= _FULLY_SUBMERGED
    immersed = {"all": known, "dry": wet <= 0, "partly": partly, "submerged": submerged}
    for band, low, high in BANDS:
        for immersion, chosen in immersed.items():
            inside = known & (low <= speed) & (speed < high) & chosen
            n, own = int(inside.sum()), error[:, inside]
            for k in range(ensemble.n_members):
                for i, component in enumerate(COMPONENTS):
                    if n == 0:
                        yield k, component, band, immersion, 0, None, None, None
                        continue
                    bias, rmse = float(own[k, :, i].mean()), float(np.sqrt((own[k, :, i] ** 2).mean()))
                    yield k, component, band, immersion, n, bias, rmse, float(np.sqrt((true[inside, i] ** 2).mean()))
