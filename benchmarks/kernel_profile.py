"""Where a generation spends its time: Linux perf samples it while it evolves, `python -m benchmarks.kernel_profile`.

Writes docs/results/kernel-profile.json, which docs/performance.md shows. It takes three minutes on one core, which must
be free, and Linux perf (Debian's package linux-perf). Samples are told apart by the memory of the compiled kernels.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.engines import N_STEPS
from benchmarks.networks import peak_gflops
from benchmarks.published import RESULTS
from pipeline.store.encoding import encode_arrays, encode_table
from pipeline.store.provenance import environment as provenance
from tasks.design import N_LINKS, Designs
from tasks.evolution import EMPTY_POPULATION, Afpo, Evaluation, Trial, evaluate, evolve
from tasks.residual import Architecture, Throws, Training, initial_states, simulate_throws
from tasks.residual.ensemble import Ensemble
from tasks.residual.training import train_member
from tasks.seeding import generator
from tasks.simulation import simulate
from tasks.simulation.networks.inference import run_networks
from tasks.simulation.trees import groups
from tasks.world import DryLand, Environment, Physics, ResidualSlush, Slush, TrueSlush

PROFILED_SHAPES = ((2, 32), (2, 48), (3, 64))
N_MEMBERS, N_DESIGNS, DEPTH = 4, 64, 9.0
_N_GENERATIONS = 100
"""Generations of a segment, after which it is encoded as a work item of a study is."""
_SECONDS = 20.0
_TRAINING = Training(n_iterations=11_000, batch_size=2048, learning_rate=1e-2, loss="mse")
KERNELS = {"base simulator": (groups.advance_kernel,), "networks": (groups._advance_coupled, run_networks)}
"""The rest is AFPO, packing, and the tables that record what happened."""


def environments() -> dict[str, Environment]:
    """Return the environments whose generations are compared, by name; the networks learn from designed throws."""
    throws = Throws(design="robots", n_throws=3400, n_steps=29)
    transitions = simulate_throws(initial_states(throws, generator(1, "throws")), 29, Slush(), Physics())
    found: dict[str, Environment] = {"True Slush": TrueSlush(DEPTH), "Dry Land": DryLand(DEPTH)}
    for layers, width in PROFILED_SHAPES:
        architecture = Architecture(hidden_layers=layers, width=width, dropout=0.0)
        members = [train_member(transitions, architecture, _TRAINING, seed=1, member=k) for k in range(N_MEMBERS)]
        ensemble = Ensemble.from_members([member.arrays() for member in members])
        found[f"Residual Slush, {N_MEMBERS} members of {layers} × {width}"] = ResidualSlush(DEPTH, ensemble)
    return found


def segments(environment: Environment) -> Iterator[None]:
    """Evolve and encode segments of one trial, for ever."""

    def score(designs: Designs) -> Evaluation:
        return evaluate(simulate(designs, environment), disagreement_penalty=1.0)

    first, population = 0, EMPTY_POPULATION
    while True:
        trial = Trial(partial(generator, 1, "trial"), population)
        ((population, history),) = evolve(
            [trial], score, first_generation=first, n_generations=_N_GENERATIONS, afpo=Afpo(population_size=N_DESIGNS)
        )
        encode_arrays(population.arrays(), schema="population", version=1, producer="profile")
        encode_table(history, schema="history", version=1, producer="profile")
        first += _N_GENERATIONS
        yield


def places() -> dict[str, list[tuple[int, int]]]:
    """Return the memory that holds each part's kernels: beginnings and ends of mappings."""
    lines = Path("/proc/self/maps").read_text().splitlines()
    mappings = [tuple(int(end, 16) for end in line.split()[0].split("-")) for line in lines]

    def mapping(address: int) -> tuple[int, int]:
        return next((low, high) for low, high in mappings if low <= address < high)

    found = {
        part: [
            mapping(result.library.get_pointer_to_function(result.fndesc.llvm_func_name))
            for kernel in kernels
            for result in kernel.overloads.values()
        ]
        for part, kernels in KERNELS.items()
    }
    if shared := set.intersection(*(set(memory) for memory in found.values())):
        raise RuntimeError(f"kernels of several parts lie in one mapping, {shared}: their samples can't be told apart")
    return found


def sampled(data: Path) -> Counter[int]:
    """Count samples by address."""
    said = subprocess.run(["perf", "script", "-i", str(data), "-F", "ip"], capture_output=True, text=True, check=True)
    return Counter(int(address, 16) for address in said.stdout.split())


def shares(samples: Mapping[int, int], where: Mapping[str, list[tuple[int, int]]]) -> dict[str, float]:
    """Return the share of each part's kernels in the samples."""
    total = sum(samples.values())
    return {
        part: sum(n for address, n in samples.items() if any(low <= address < high for low, high in memory)) / total
        for part, memory in where.items()
    }


def profile(environment: Environment) -> dict[str, Any]:
    """Sample this process while it evolves in an environment."""
    running = segments(environment)
    next(running)
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "perf.data"
        command = ["perf", "record", "-e", "cpu-clock", "-F", "997", "-p", str(os.getpid()), "-o", str(data)]
        recorder = subprocess.Popen([*command, "--", "sleep", str(_SECONDS)])
        begun, n_segments = time.process_time(), 0
        while recorder.poll() is None:
            next(running)
            n_segments += 1
        seconds = (time.process_time() - begun) / (n_segments * _N_GENERATIONS)
        if recorder.returncode != 0:
            raise RuntimeError(f"perf record failed with exit code {recorder.returncode}; see perf's own message")
        samples = sampled(data)
    found = shares(samples, places())
    return {
        "seconds": round(seconds, 5),
        "n_samples": sum(samples.values()),
        "shares": {part: round(share, 4) for part, share in found.items()},
        "gflop": round(gflop(environment), 3),
    }


def gflop(environment: Environment) -> float:
    """Return the multiplications and additions of the networks in a generation [10⁹]."""
    if not isinstance(environment.medium, Ensemble):
        return 0.0
    n_rows = N_DESIGNS * N_LINKS * N_STEPS  # evaluations of a member
    return 2e-9 * n_rows * sum(weights.size for weights in environment.medium.weights)


def main() -> None:
    """Profile every environment and write the results."""
    peak = max(peak_gflops() for _ in range(5))
    rows = []
    for name, environment in environments().items():
        rows.append({"environment": name, **profile(environment)})
        print(rows[-1], flush=True)
    document = {
        "schema": "puddle.kernel_profile",
        "version": 1,
        "made_with": dict(provenance()),
        "peak_gflops": round(peak),
        "rows": rows,
    }
    text = json.dumps(document, indent=1, ensure_ascii=False)
    (RESULTS / "kernel-profile.json").write_text(f"{text}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
