"""Instruments: where the members are wrong, and what champions gain by it.

Part of the stage analyse, whose docstring lists the tables. Phantom thrust, disagreement, novelty, luck and reach where
champions evolved do not need True Slush.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.config.settings import RESIDUAL_ENVIRONMENTS
from pipeline.report.findings import ChampionCoverageRow, ChampionRow, Moved
from pipeline.stages import environments
from pipeline.stages.analyses.analysis_tables import Reasons, Tables
from pipeline.stages.analyses.champion_coverage import champion_coverage
from pipeline.stages.analyses.champions import Champion, champions
from pipeline.stages.analyses.filmed_rollouts import Filmed, best_of, film_arm, home_of
from pipeline.stages.analyses.specs import InstrumentsSpec, MembersSpec
from pipeline.stages.collect import read_transitions, throws_among
from pipeline.stages.data_sets import DataSetId
from pipeline.stages.environments import networks_among
from pipeline.store.tables import Columns, columns_of
from pipeline.workflow.stage import Inputs, Job
from tasks.analysis.hallucination import Disagreement, disagreement, link_states
from tasks.analysis.luck import Luck, luck
from tasks.analysis.member_error import MemberError, member_errors, phantom_thrust, thrown_links
from tasks.analysis.novelty import SPACE, Novelty, Thrown, novelty, thrown
from tasks.analysis.uncertainty import Estimate
from tasks.arrays import Float64
from tasks.design import Designs
from tasks.design.genes import concatenate
from tasks.residual import Transitions, split_throws
from tasks.seeding import generator, replicate_seed
from tasks.world import EnsembleMedium, Physics

N_TRIES = 32  # repeats of each champion: the standard error of its loss is then a fifth of their standard deviation


def transitions_of(held_out: float, seed: int, inputs: Inputs, data_set: DataSetId) -> tuple[Transitions, Transitions]:
    """Return the throws that the members of an ensemble were trained on, and those that they are validated on.

    Args:
        held_out: share of the throws that are held out.
        seed: seed of the study.
        inputs: files by name, with the throws.
        data_set: the data set that the ensemble learned from.
    """
    transitions = read_transitions(throws_among(inputs, data_set))
    seed = replicate_seed(seed, data_set.replicate)
    learned, validated = split_throws(transitions.throw, held_out, seed=seed)
    return transitions[learned], transitions[validated]


@dataclass(frozen=True)
class ThrustRow:
    """The phantom thrust of one member."""

    member: int
    thrust: Estimate  # [m/s²]


def compute_members(job: Job[MembersSpec], inputs: Inputs) -> tuple[Tables, Reasons]:
    """Measure the errors of each member on held-out throws."""
    spec, why = job.spec, job.spec.no_networks
    thrusts: list[ThrustRow] = []
    errors: Sequence[MemberError] = ()
    if not why:
        data_set = environments.main_data_set_among(inputs)
        ensemble = environments.ensemble_of(environments.ensemble_among(inputs, data_set))
        _, held_out = transitions_of(spec.held_out, spec.seed, inputs, data_set)
        rng = generator(spec.seed, "analyse", "phantom thrust")
        physics = spec.simulation.physics
        found = phantom_thrust(ensemble, held_out, physics, rng=rng)
        thrusts = [ThrustRow(member, thrust) for member, thrust in enumerate(found)]
        medium = environments.true_medium(spec.simulation.media)
        errors = member_errors(ensemble, medium, thrown_links(held_out, physics), physics)
    tables = {"phantom_thrust": columns_of(ThrustRow, thrusts), "member_errors": columns_of(MemberError, errors)}
    return tables, dict.fromkeys(tables, why) if why else {}


@dataclass(frozen=True)
class FilmRow:
    """A film of the best champion whose links are in the table of links."""

    seen_in: str
    member: int
    trial: int
    displacement: float
    disagreement: float  # mean over steps and links [m/s²]
    share_novel: float  # share of steps and links with a novelty above 1
    thrust: tuple[float, ...]  # (n_members,) mean departure along x [m/s²]


def compute_arm(job: Job[InstrumentsSpec], inputs: Inputs) -> tuple[Tables, Reasons]:
    """Apply every instrument to the champions of one arm."""
    spec, simulation = job.spec, job.spec.simulation
    arm = champions(spec.trials, inputs)
    if not arm:
        tables = _arm_tables([], [], [], [], 1)
        return tables, dict.fromkeys(tables, "no trial of this arm has a champion")
    designs = concatenate([champion.design for champion in arm])
    true_slush = environments.true_slush(simulation.media, spec.arm.depth)
    in_slush = environments.roll_out(simulation, job.execution, true_slush, designs, trace=True)
    assert in_slush.trace is not None
    best, survives = best_of(arm)
    moved = _moved(in_slush.displacement, in_slush.com_displacement)
    rows = [_champion_row(job, inputs, champion, moved[i], best=i == best) for i, champion in enumerate(arm)]
    if why := job.spec.no_networks:
        lacking = dict.fromkeys(("champion_coverage", "links", "films", "member_errors"), why)
        return _arm_tables(rows, [], [], [], 1), lacking
    data_set, physics = environments.data_set_among(inputs, arm[best].trial), simulation.physics
    ensemble = environments.ensemble_of(environments.ensemble_among(inputs, data_set))
    links = link_states(designs, in_slush.trace, physics)
    errors = member_errors(ensemble, environments.true_medium(simulation.media), links, physics)
    learned, _ = transitions_of(spec.held_out, spec.seed, inputs, data_set)
    index = thrown(learned.observation, learned.throw)
    films = film_arm(simulation, job.execution, arm, networks_among(inputs))
    seen = [_measure(film, ensemble, index, physics) for film in films]
    lost = None if survives else "no champion of this arm stays finite in True Slush: shown where the best evolved"
    remarks = [why for why in (lost, *(measured.disagreement.reason for measured in seen[:1]), index.reason) if why]
    reasons = dict.fromkeys(("links", "films"), "; ".join(remarks)) if remarks else {}
    covered = champion_coverage(job, inputs, arm)
    return _arm_tables(rows, covered, errors, seen, ensemble.n_members), reasons


def _arm_tables(
    rows: Sequence[ChampionRow],
    covered: Sequence[ChampionCoverageRow],
    errors: Sequence[MemberError],
    seen: Sequence[MeasuredFilm],
    n_members: int,
) -> Tables:
    return {
        "champions": columns_of(ChampionRow, rows),
        "champion_coverage": columns_of(ChampionCoverageRow, covered),
        "member_errors": columns_of(MemberError, errors),
        **_link_tables(seen, n_members),
    }


def _moved(displacement: Float64, com_displacement: Float64) -> list[Moved]:
    moved = np.stack((displacement, com_displacement)).astype(np.float64)
    return [Moved(root, whole, root - whole) for root, whole in moved.T.tolist()]


def _champion_row(
    job: Job[InstrumentsSpec], inputs: Inputs, champion: Champion, slush: Moved, *, best: bool
) -> ChampionRow:
    spec, trial = job.spec, champion.trial
    if trial.environment in RESIDUAL_ENVIRONMENTS and job.spec.no_networks:
        untried = Luck(champion.fitness, np.nan, Estimate.missing(job.spec.no_networks), np.nan, 0, 0)
        return ChampionRow(trial.index, best, Moved(np.nan, np.nan, np.nan), slush, untried)
    environment = home_of(spec.simulation, champion, networks_among(inputs))
    score = environments.scorer(spec.simulation, job.execution, environment, spec.fitness)
    at_home = score(champion.design)
    (home,) = _moved(at_home.displacement.mean(axis=1), at_home.com_displacement.mean(axis=1))

    def fitness(designs: Designs) -> Float64:
        return score(designs).fitness

    rng = generator(spec.seed, "analyse", "luck", trial.environment, trial.depth, trial.index)
    return ChampionRow(trial.index, best, home, slush, luck(champion.design, fitness, rng=rng, n_tries=N_TRIES))


@dataclass(frozen=True, eq=False)
class MeasuredFilm:
    """The measurements along a film."""

    row: FilmRow
    disagreement: Disagreement
    novelty: Novelty


def _measure(film: Filmed, ensemble: EnsembleMedium, throws: Thrown, physics: Physics) -> MeasuredFilm:
    """Measure disagreement and novelty along a film."""
    champion = film.champion
    along = disagreement(champion.design, film.trace, ensemble, physics)
    new = novelty(link_states(champion.design, film.trace, physics), throws)
    known = new.novelty[np.isfinite(new.novelty)]
    share_novel = float((known > 1).mean()) if len(known) else np.nan
    mean = float(along.by_design()[0])
    thrust = tuple(along.member_thrust()[:, 0].tolist())
    row = FilmRow(film.seen_in, film.member, champion.trial.index, film.displacement, mean, share_novel, thrust)
    return MeasuredFilm(row, along, new)


def _link_tables(seen: Sequence[MeasuredFilm], n_members: int) -> Tables:
    """Return a row per film, step and link, and a row per film."""
    parts = [_links(measured.row.seen_in, measured.disagreement, measured.novelty) for measured in seen]
    if not parts:
        none, several = np.zeros((1, 0, 1)), np.zeros((n_members, 1, 0, 1), np.float32)
        undecided = Disagreement(none.astype(np.float32), several, several, None)
        parts = [_links("", undecided, Novelty(none, none, none.astype(np.int64)))]
    return {
        "links": {name: np.concatenate([part[name] for part in parts]) for name in parts[0]},
        "films": columns_of(FilmRow, [measured.row for measured in seen]),
    }


def _links(seen_in: str, along: Disagreement, new: Novelty) -> Columns:
    n_steps, n_links = along.magnitude.shape[1:]
    n_members, n = len(along.departure), n_steps * n_links
    names = np.array([*SPACE, ""])  # the last by index -1: unknown
    return {
        "seen_in": np.full(n, seen_in),
        "step": np.repeat(np.arange(n_steps), n_links),
        "link": np.tile(np.arange(n_links), n_steps),
        "disagreement": along.magnitude.ravel(),
        "novelty": new.novelty.ravel().astype(np.float32),
        "distance": new.distance.ravel().astype(np.float32),
        "component": names[new.component.ravel()],
        "departure": along.departure.reshape(n_members, n).T,
        "thrust": along.thrust.reshape(n_members, n).T,
    }
