"""Measure what networks get wrong along the paths of robots, by throws and networks: `python -m benchmarks.throws`.

Writes docs/results/throws.json, which docs/throws.md shows, and keeps its rows that no code measures any more. It takes
four minutes on one core. `python -m benchmarks.throws inference` measures the time of inference alone, and `python
-m benchmarks.throws regularisation` trains with and without dropout and weight decay; they take a minute each.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from benchmarks.engines import N_STEPS
from benchmarks.measure import seconds
from benchmarks.networks import ensemble
from benchmarks.published import RESULTS
from pipeline.store.provenance import environment as provenance
from tasks.arrays import Float32, Float64
from tasks.design import random_designs
from tasks.design.genes import concatenate
from tasks.evolution import EMPTY_POPULATION, PAPERS_OBJECTIVE, Afpo, Trial, evaluate, evolve
from tasks.residual import OBSERVATION, Architecture, Throws, Training, initial_states, simulate_throws
from tasks.residual.ensemble import Ensemble
from tasks.residual.observation import Observed
from tasks.residual.training import train_member
from tasks.seeding import generator
from tasks.simulation import simulate
from tasks.simulation.free_links import FreeLinks
from tasks.world import Environment, LinkStates, Physics, ResidualSlush, Slush, TrueSlush

DEPTHS = (1.0, 2.0, 4.0, 9.0)
_N_TRIALS, _N_GENERATIONS, _EVERY, _N_NETWORKS = 3, 400, 7, 2
_REGULARISED, _N_REGULARISED = (2, 48), 4  # hidden layers and width of desk's networks; networks of each row
_N_DESIGNS, _N_MEMBERS, _N_TIMED, _DEPTH_OF_INFERENCE = 16, 4, 12, 9.0
_MAGNITUDES: tuple[Observed, ...] = (*OBSERVATION, "speed", "abs_omega", "abs_sin_angle")
_TRAINING = Training(n_iterations=11_000, batch_size=2048, learning_rate=1e-2, loss="mse")

THROWS = {
    "paper": [(500, 200)],
    "robots": [(2500, 40), (5000, 20), (1250, 80), (500, 200), (500, 40), (100, 40), (100, 200), (3400, 29)],
}
NETWORKS = [
    (2, 32, OBSERVATION),
    (2, 32, _MAGNITUDES),
    (2, 48, OBSERVATION),
    (2, 48, _MAGNITUDES),
    (3, 32, _MAGNITUDES),
    (3, 64, OBSERVATION),
]


def robots(depth: float) -> tuple[LinkStates, Float64]:
    """Return the states of links of robots that evolved in True Slush, and the true (n_states, 3) velocity changes."""
    trials = [Trial(partial(generator, 7, "robots", k), EMPTY_POPULATION) for k in range(_N_TRIALS)]
    environment = TrueSlush(depth=depth)
    found = evolve(
        trials,
        lambda designs: evaluate(simulate(designs, environment), disagreement_penalty=0.0, objective=PAPERS_OBJECTIVE),
        first_generation=0,
        n_generations=_N_GENERATIONS,
        afpo=Afpo.model_validate({"population_size": 16, "mutation": {"step": 0.2}}),
    )
    designs = concatenate([population.designs[population.champion()] for population, _ in found])
    trace = simulate(designs, environment, trace=True).trace
    assert trace is not None
    state = trace[:, ::_EVERY]
    length_scale = np.broadcast_to(designs.length_scale[:, None, :], state.shape[:-1]).reshape(-1)
    state = state.reshape(-1, state.shape[-1])
    links = FreeLinks(length_scale, Physics())
    change = links.step(state, Slush()) - links.step(state, None)
    return _links(length_scale, state), change[:, 3:].astype(np.float64)


def _links(length_scale: Float64, state: Float32) -> LinkStates:
    _, y, angle, vx, vy, omega = state.T
    one = np.ones_like(y)
    return LinkStates(length_scale.astype(np.float32), one, one, y, np.cos(angle), np.sin(angle), vx, vy, omega)


def errors(ensemble: Ensemble, links: LinkStates, true: Float64) -> Sequence[float]:
    """Return the error of vx, vy and ω as shares of the deviation of the true changes; the mean over networks."""
    several = LinkStates(**{name: np.stack([of] * ensemble.n_members) for name, of in vars(links).items()})
    change = ensemble.velocity_change(several, Physics())
    predicted = np.stack([change.vx, change.vy, change.omega], axis=-1)
    rmse = np.sqrt(np.square(predicted - true).mean(axis=1)).mean(axis=0)
    return [round(float(share), 3) for share in rmse / true.std(axis=0)]


def row(
    design: str, n_throws: int, n_steps: int, network: tuple[int, int, Any], at: dict[float, Any]
) -> dict[str, Any]:
    """Train two networks on throws and measure them.

    Args:
        design: of the throws.
        n_throws: number of throws.
        n_steps: steps of each.
        network: number of hidden layers, width and inputs.
        at: states and changes of robots by depth [m].

    Returns:
        A row of the results file.
    """
    layers, width, inputs = network
    throws = Throws.model_validate({"design": design, "n_throws": n_throws, "n_steps": n_steps})
    transitions = simulate_throws(initial_states(throws, generator(1, "throws")), n_steps, Slush(), Physics())
    architecture = Architecture(hidden_layers=layers, width=width, dropout=0.0, observation=inputs)
    start = time.process_time()
    members = [
        train_member(transitions, architecture, _TRAINING, seed=1, member=k).arrays() for k in range(_N_NETWORKS)
    ]
    seconds = (time.process_time() - start) / _N_NETWORKS
    ensemble = Ensemble.from_members(members)
    return {
        "throws": design,
        "n_throws": n_throws,
        "n_steps": n_steps,
        "network": f"{layers} × {width}",
        "inputs": len(inputs),
        "seconds": round(seconds, 1),
        "error": {f"{depth:g}": errors(ensemble, *found) for depth, found in at.items()},
    }


def regularisation() -> dict[str, Any]:
    """Return the errors of networks with and without dropout and weight decay; a preset has both at their defaults."""
    at = {depth: robots(depth) for depth in DEPTHS}
    n_throws, n_steps = THROWS["robots"][-1]
    throws = Throws(design="robots", n_throws=n_throws, n_steps=n_steps)
    transitions = simulate_throws(initial_states(throws, generator(1, "throws")), n_steps, Slush(), Physics())
    layers, width = _REGULARISED
    rows = []
    for dropout, weight_decay in product((Architecture().dropout, 0.0), (Training().weight_decay, 0.0)):
        architecture = Architecture(hidden_layers=layers, width=width, dropout=dropout)
        training = _TRAINING.model_copy(update={"weight_decay": weight_decay})
        members = [train_member(transitions, architecture, training, seed=1, member=k) for k in range(_N_REGULARISED)]
        each = [Ensemble.from_members([member.arrays()]) for member in members]
        found = {f"{depth:g}": [errors(one, *states) for one in each] for depth, states in at.items()}
        rows.append({"dropout": dropout, "weight_decay": weight_decay, "errors_of_networks": found})
        print(rows[-1], flush=True)
    network = f"{layers} × {width}"
    return {"made_with": dict(provenance()), "network": network, "n_networks": _N_REGULARISED, "rows": rows}


def inference() -> dict[str, Any]:
    """Return what a generation takes with ensembles of several sizes, beside one in True Slush, on one core."""
    designs = random_designs(_N_DESIGNS, generator(1, "inference"))
    environments: dict[tuple[str, int], Environment] = {("none", 0): TrueSlush(depth=_DEPTH_OF_INFERENCE)}
    for layers, width, inputs in NETWORKS:
        of = ensemble(layers, width, _N_MEMBERS, inputs)
        environments[f"{layers} × {width}", len(inputs)] = ResidualSlush(_DEPTH_OF_INFERENCE, of)
    rows = []
    for (network, n_inputs), environment in environments.items():
        simulate(designs, environment, n_settle=1, n_measure=1)
        fastest = min(seconds(lambda of=environment: simulate(designs, of)) for _ in range(_N_TIMED))
        rows.append({"network": network, "inputs": n_inputs, "seconds": round(fastest, 4)})
        print(rows[-1], flush=True)
    return {
        "made_with": dict(provenance()),
        "n_designs": _N_DESIGNS,
        "n_members": _N_MEMBERS,
        "n_steps": N_STEPS,
        "rows": rows,
    }


def kept(recorded: Sequence[dict[str, Any]], measured: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the recorded rows of a forerunner, and those that are not measured any more, marked as such."""
    names = ("throws", "n_throws", "n_steps", "network", "inputs")
    again = {tuple(row[name] for name in names) for row in measured}
    return [
        row | {"forerunner": True}
        for row in recorded
        if row.get("forerunner") or tuple(row[name] for name in names) not in again
    ]


def main() -> None:
    """Measure every row and write the file."""
    file = RESULTS / "throws.json"
    parts = {"inference": inference, "regularisation": regularisation}
    if (part := "".join(sys.argv[1:])) in parts:
        document = {**json.loads(file.read_text(encoding="utf-8")), part: parts[part]()}
        file.write_text(f"{json.dumps(document, indent=1, ensure_ascii=False)}\n", encoding="utf-8")
        return
    at = {depth: robots(depth) for depth in DEPTHS}
    cases = [(design, *size, NETWORKS[0]) for design, sizes in THROWS.items() for size in sizes]
    cases += [("paper", 500, 200, NETWORKS[1]), *(("robots", 3400, 29, network) for network in NETWORKS[1:])]
    rows = []
    for case in cases:
        rows.append(row(*case, at))
        print(rows[-1], flush=True)
    recorded = json.loads(file.read_text(encoding="utf-8"))["errors"]
    document = {
        "schema": "puddle.throws",
        "version": 1,
        "made_with": dict(provenance()),
        "errors": [*rows, *kept(recorded, rows)],
        "inference": inference(),
        "regularisation": regularisation(),
    }
    file.write_text(f"{json.dumps(document, indent=1, ensure_ascii=False)}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
