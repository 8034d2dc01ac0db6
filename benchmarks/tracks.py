"""Measure what tracked throws are worth: `python -m benchmarks.tracks [residuals] [robots] [studies] [fluids]`.

Writes docs/results/tracks-rollouts.json, which docs/your-own-tank.md shows; without arguments, all parts of it. A
simulation with steps of 1/960 s stands in for the tank, and exact poses, with noise or without, for the camera. Rows
that the file has are not measured again. tracks.json has what was measured before rollouts were the default.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import cache, partial
from typing import Any, Literal, get_args

import numpy as np

from benchmarks import throws
from benchmarks.published import RESULTS
from pipeline.store.provenance import environment as provenance
from tasks.analysis.paper import DEPTH
from tasks.arrays import Float64
from tasks.design.genes import concatenate
from tasks.evolution import EMPTY_POPULATION, PAPERS_OBJECTIVE, Afpo, Trial, evaluate, evolve
from tasks.residual import Architecture, Throws, Training, Transitions, error_rows, initial_states, simulate_throws
from tasks.residual.ensemble import Ensemble
from tasks.residual.observation import OBSERVATION, Observed
from tasks.residual.throws import Starts
from tasks.residual.training import train_member
from tasks.seeding import generator
from tasks.simulation import simulate
from tasks.simulation.free_links import FreeLinks
from tasks.tracks import Bars, Tracks, TrackTable, residual_transitions
from tasks.world import Environment, Medium, Physics, ResidualSlush, Slush, TrueSlush, froude_time
from tasks.world.anisotropic_slush import AnisotropicPool
from tasks.world.flowing_slush import FlowingPool

LENGTH = 0.07  # bench metres per metre of simulation
TIME = froude_time(LENGTH)
SECONDS = 1.0  # each throw is followed for [s of simulation]
_FINE = 960  # steps of the tank in a second of simulation
_N_MEMBERS, _N_TRIALS, _N_GENERATIONS = 4, 16, 300
N_DATA_SETS = 8  # of a study: sets of throws with an ensemble each, in which as many of its trials evolve
N_MORE_TRIALS = 48  # of the studies that show whether tracks without noise, and videos, are as good as exact states
_FLUIDS_DEPTH = 2.0  # [m]
_TRAINING = Training(n_iterations=11_000, batch_size=2048, learning_rate=1e-2, loss="mse")
_AFPO = Afpo.model_validate({"population_size": 16, "mutation": {"step": 0.2}})
PHYSICS = Physics()


@dataclasses.dataclass(frozen=True)
class SimulatedCamera:
    """What is seen of the throws."""

    n_throws: int = 500
    rate: float = 60.0  # frames a second of the bench
    noise_mm: float = 0.0
    noise_deg: float = 0.0


def starts(n_throws: int, data_set: int = 0) -> Starts:
    """Return starts that are designed for robots, others in each data set."""
    designed = Throws(design="robots", n_throws=n_throws, n_steps=None)
    return initial_states(designed, generator(1, "throws", *_unless_first(data_set)), PHYSICS)


def _unless_first(data_set: int) -> tuple[int, ...]:
    """Return what a data set adds to its seeds. The first adds nothing: its rows were measured as the only one."""
    return (data_set,) if data_set else ()


@cache
def paths(n_throws: int, medium: Medium, data_set: int = 0) -> Float64:
    """Return (n_throws, n_fine + 1, 3) poses of bars in the tank, in units of the simulation."""
    thrown = starts(n_throws, data_set)
    links = FreeLinks(thrown.length_scale, Physics(time_step=1 / _FINE))
    now, poses = thrown.state, [thrown.state[:, :3]]
    for _ in range(round(SECONDS * _FINE)):
        now = links.step(now, medium)
        poses.append(now[:, :3])
    return np.stack(poses, axis=1).astype(np.float64)


def tracked(camera: SimulatedCamera, medium: Medium, data_set: int = 0) -> tuple[TrackTable, Bars]:
    """Film the throws; return the tracks in units of the bench."""
    path = paths(camera.n_throws, medium, data_set)
    time_seen = np.arange(int(SECONDS * TIME * camera.rate) + 1) / camera.rate
    fine = time_seen / TIME * _FINE
    before = np.minimum(fine.astype(int), path.shape[1] - 2)
    after = (fine - before)[:, None]
    seen = path[:, before] * (1 - after) + path[:, before + 1] * after
    rng = generator(1, "camera", camera.rate, camera.noise_mm, camera.noise_deg, *_unless_first(data_set))
    scale = np.array([LENGTH, LENGTH, 1.0])
    noise = np.array([camera.noise_mm / 1000, camera.noise_mm / 1000, np.radians(camera.noise_deg)])
    pose = seen * scale + rng.normal(size=seen.shape) * noise
    pose[..., 2] = np.remainder(pose[..., 2] + np.pi, 2 * np.pi) - np.pi
    n, n_frames = pose.shape[:2]
    length = starts(n, data_set).length_scale * LENGTH
    table = TrackTable(np.repeat(np.arange(n), n_frames), np.tile(time_seen, n), *pose.reshape(-1, 3).T)
    return table, Bars(np.arange(n), length, LENGTH**2 / length, np.full(n, 0.098))


def learned(transitions: Transitions, inputs: tuple[Observed, ...] = OBSERVATION, *, seed: int = 1) -> Ensemble:
    """Train an ensemble of networks of 2 × 32."""
    architecture = Architecture(hidden_layers=2, width=32, observation=inputs)
    members = [train_member(transitions, architecture, _TRAINING, seed=seed, member=k) for k in range(_N_MEMBERS)]
    return Ensemble.from_members([member.arrays() for member in members])


def displacements(
    evolved_in: Environment, tested_in: Environment, *, n_trials: int = _N_TRIALS, first_trial: int = 0
) -> list[float]:
    """Evolve the trials of a small study; return where the champions get in another environment [m]."""
    found = evolve(
        [Trial(partial(generator, 7, "tracks", first_trial + k), EMPTY_POPULATION) for k in range(n_trials)],
        lambda designs: evaluate(simulate(designs, evolved_in), disagreement_penalty=1.0, objective=PAPERS_OBJECTIVE),
        first_generation=0,
        n_generations=_N_GENERATIONS,
        afpo=_AFPO,
    )
    champions = concatenate([population.designs[population.champion()] for population, _ in found])
    return [round(float(of), 2) for of in np.ravel(simulate(champions, tested_in).displacement)]


def exact(n_throws: int, medium: Medium, data_set: int = 0) -> Transitions:
    """Return the same throws as a study simulates them."""
    return simulate_throws(starts(n_throws, data_set), round(SECONDS * 60), medium, PHYSICS)


def residual_errors(transitions: Transitions, medium: Medium) -> dict[str, list[float]]:
    """Compare residuals with those of the medium in the same states; as shares of their size, by speed."""
    links = FreeLinks(transitions.length_scale, PHYSICS)
    true = links.step(transitions.state, medium) - transitions.next_on_dry_land
    vx, vy = transitions.state[:, 3], transitions.state[:, 4]
    rows = error_rows(transitions.residual, true, np.hypot(vx, vy))
    bands = dict.fromkeys(row.band for row in rows if row.n_rows)
    return {
        band: [round(of.relative_error, 3) for of in rows if of.band == band and of.component in ("vx", "vy", "omega")]
        for band in bands
    }


CAMERAS = (
    SimulatedCamera(),
    SimulatedCamera(noise_mm=0.3, noise_deg=0.5),
    SimulatedCamera(rate=120.0, noise_mm=0.3, noise_deg=0.5),
    SimulatedCamera(noise_mm=1.0, noise_deg=1.0),
    SimulatedCamera(noise_mm=2.0, noise_deg=2.0),
)
FEWER = (
    SimulatedCamera(n_throws=250, noise_mm=0.3, noise_deg=0.5),
    SimulatedCamera(n_throws=100, noise_mm=0.3, noise_deg=0.5),
)

Fit = Literal["rollouts", "steps"]  # of the settings tracks.fit
_Row = dict[str, Any]
Measurement = tuple[_Row, Callable[[], _Row]]  # what identifies a row, and what measures the rest of it


@cache
def measured(camera: SimulatedCamera, medium: Medium, fit: Fit = "rollouts", data_set: int = 0) -> Transitions:
    """Return the transitions of filmed throws."""
    return residual_transitions(*tracked(camera, medium, data_set), Tracks(file="tracks", fit=fit), PHYSICS)[0]


def residuals() -> Iterator[Measurement]:
    """Yield the errors of residuals for each camera, by speed of the bar."""
    for camera in CAMERAS:
        yield dataclasses.asdict(camera), lambda of=camera: {"error": residual_errors(measured(of, Slush()), Slush())}


def robots() -> Iterator[Measurement]:
    """Yield what networks get wrong along the paths of robots that evolved in True Slush, by what they learned from."""
    at = cache(lambda: throws.robots(DEPTH))

    def errors(transitions: Transitions) -> _Row:
        return {"error": throws.errors(learned(transitions), *at())}

    yield {"learned_from": "exact states", "n_throws": 500}, lambda: errors(exact(500, Slush()))
    for camera in CAMERAS[:3]:
        for fit in get_args(Fit):
            row = {"learned_from": "tracks", "fit": fit, **dataclasses.asdict(camera)}
            yield row, lambda of=camera, fit=fit: errors(measured(of, Slush(), fit))


def study(
    transitions: Callable[[int], Transitions],
    true: Environment,
    inputs: tuple[Observed, ...] = OBSERVATION,
    *,
    n_data_sets: int = 1,
    n_trials: int = _N_TRIALS,
) -> _Row:
    """Evolve in networks, and return where the champions get in the environment that they were learned from.

    Args:
        transitions: returns what the networks of a data set learn from, by the data set's number.
        true: the environment.
        inputs: what the networks observe.
        n_data_sets: data sets, each with an ensemble of its own, over which the trials are spread evenly.
        n_trials: trials of evolution.
    """
    displacement, n_each = [], n_trials // n_data_sets
    for data_set in range(n_data_sets):
        ensemble = learned(transitions(data_set), inputs, seed=1 + data_set)
        home = ResidualSlush(true.depth, ensemble)
        displacement += displacements(home, true, n_trials=n_each, first_trial=data_set * n_each)
    return {"data_sets": n_data_sets, "displacement": displacement}


def studies() -> Iterator[Measurement]:
    """Yield where champions of a small study get in True Slush, by what its networks learned from."""
    true = TrueSlush(DEPTH)
    learn = partial(study, true=true, n_data_sets=N_DATA_SETS)
    yield {"learned_from": "nothing"}, lambda: {"displacement": displacements(true, true)}
    exact_states = {"learned_from": "exact states", "n_throws": 500}
    yield exact_states, lambda: learn(lambda of: exact(500, Slush(), of), n_trials=N_MORE_TRIALS)
    for camera in CAMERAS + FEWER:
        row = {"learned_from": "tracks", **dataclasses.asdict(camera)}
        n_trials = N_MORE_TRIALS if camera == CAMERAS[0] else _N_TRIALS
        yield row, lambda seen=camera, n=n_trials: learn(lambda of: measured(seen, Slush(), data_set=of), n_trials=n)


def fluids() -> Iterator[Measurement]:
    """Yield where champions get in fluids that the learner does not know, learned from tracks with sin θ."""
    camera, inputs = SimulatedCamera(noise_mm=0.1, noise_deg=0.2), (*OBSERVATION, "sin_angle")
    for name, true in (("anisotropic", AnisotropicPool(_FLUIDS_DEPTH)), ("flowing", FlowingPool(_FLUIDS_DEPTH))):
        row = {"fluid": name, "learned_from": "nothing"}
        yield row, lambda at=true: {"displacement": displacements(at, at)}
        row = {"fluid": name, "learned_from": "tracks"}
        yield row, lambda at=true: study(lambda _: measured(camera, at.medium), at, inputs)


PARTS: dict[str, Callable[[], Iterator[Measurement]]] = {
    "residuals": residuals,
    "robots": robots,
    "fluids": fluids,
    "studies": studies,
}


def measure_missing(part: str, measurements: Iterable[Measurement]) -> None:
    """Measure the rows that the file lacks of a part, and write it after each."""
    path = RESULTS / "tracks-rollouts.json"
    for identity, measure in measurements:
        document = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        rows = document.setdefault(part, [])
        if any(identity.items() <= row.items() for row in rows):
            continue
        rows.append({**identity, **measure()})
        print(rows[-1], flush=True)
        document |= {"schema": "puddle.tracks", "version": 1, "made_with": dict(provenance())}
        path.write_text(f"{json.dumps(document, indent=1, ensure_ascii=False)}\n", encoding="utf-8")


def main() -> None:
    """Measure the parts that are named, or all."""
    for part in sys.argv[1:] or PARTS:
        measure_missing(part, PARTS[part]())


if __name__ == "__main__":
    main()
