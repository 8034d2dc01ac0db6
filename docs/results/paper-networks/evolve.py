"""Evolve robots under the paper's networks at 9 m: one trial under each ensemble, one under its first network.

The engine steps the robots on the CPU's cores. One GPU predicts the velocity changes of all links of all trials in each
step, in float32 or, with --tf32, with products of TF32. In the checkout, with torch for CUDA:

    PYTHONPATH=. python docs/results/paper-networks/evolve.py --tf32 --out FOLDER

FOLDER/evolution-K.npz has the displacements [m] of all designs of data set K, of the root and of the whole robot, under
the members of the ensemble and, last, the single network: (n_generations, n_designs, n_members + 1, 2). The designs
follow from them and the seeds; benchmarks/paper_networks.py makes a study's trials of them. The tables of the last
survivors' genes serve to check that.
"""

import argparse
import mmap
import multiprocessing
import os
import time
from dataclasses import fields
from pathlib import Path

import numba
import numpy as np
import torch
from safetensors.numpy import load_file
from tasks.residual.observation import INPUTS, OBSERVATION

from tasks.design import Designs
from tasks.design.genes import N_COLUMNS, N_LINKS
from tasks.evolution import EMPTY_POPULATION, Afpo, Evaluation, penalised_mean
from tasks.residual.ensemble import Ensemble
from tasks.residual.network import Standardisation
from tasks.seeding import generator
from tasks.simulation import simulate
from tasks.simulation.trees import layout
from tasks.simulation.trees.groups import Groups
from tasks.world import ResidualSlush

FOLDER = Path(__file__).parent
DEPTH, SEED = 9.0, 1  # these and Afpo() are the preset's
N_SETTLE, N_MEASURE = 200, 1200
READ = np.array([layout.QUANTITIES[INPUTS[name]] for name in OBSERVATION])
WRITTEN = np.array([layout.VX, layout.VY, layout.OMEGA])


@numba.njit(error_model="numpy")
def read(blocks, rows, x):
    """Copy links of full (n_groups, n_rows, n_lanes) robots to (n_robots, n_links, n_inputs) inputs of networks."""
    n_lanes = blocks.shape[2]
    for group in range(blocks.shape[0]):
        for link in range(x.shape[1]):
            for k in range(len(rows)):
                for lane in range(n_lanes):
                    x[group * n_lanes + lane, link, k] = blocks[group, rows[k] + link, lane]


@numba.njit(error_model="numpy")
def add(blocks, rows, y):
    """Add (n_robots, n_links, 3) changes to the links' velocities."""
    n_lanes = blocks.shape[2]
    for group in range(blocks.shape[0]):
        for link in range(y.shape[1]):
            for k in range(len(rows)):
                for lane in range(n_lanes):
                    blocks[group, rows[k] + link, lane] += y[group * n_lanes + lane, link, k]


class Exchange:
    """A medium of this process's robots whose changes another process computes, by numbered requests."""

    n_members = 1

    def __init__(self, x, y, sent, answered):
        self.x, self.y, self.sent, self.answered = x, y, sent, answered

    def push(self, blocks):
        """Send the links' states, wait for the changes and add them."""
        read(blocks, READ, self.x)
        self.sent[0] += 1
        number = self.sent[0]
        while self.answered[0] < number:
            os.sched_yield()
        add(blocks, WRITTEN, self.y)

    def velocity_change(self, links, physics):
        """Never called: push replaces Groups.push."""


Groups.push = lambda robots, around: around.medium.push(robots.blocks)  # faster than velocity_change, which copies


def shared(*shape, dtype=np.float32):
    """Return an array that processes share after a fork."""
    return np.frombuffer(mmap.mmap(-1, int(np.prod(shape)) * np.dtype(dtype).itemsize), dtype).reshape(shape)


def work(exchange, tables, generation, scores):
    """Simulate a share of every generation's robots."""
    done = 0
    while True:
        while generation[0] == done:
            os.sched_yield()
        done = generation[0]
        designs = Designs.from_table(tables.reshape(-1, N_COLUMNS).copy())
        rolled = simulate(designs, ResidualSlush(DEPTH, exchange), n_settle=N_SETTLE, n_measure=N_MEASURE)
        scores[..., 0] = rolled.displacement.reshape(scores.shape[:-1])
        scores[..., 1] = rolled.com_displacement.reshape(scores.shape[:-1])
        exchange.sent[1] = done


class Predictor:
    """Predicts (n_networks, n_rows, 3) changes y of (n_networks, n_rows, 6) observations x."""

    def __init__(self, weights, biases, x, y, tf32):
        torch.backends.cuda.matmul.allow_tf32 = tf32
        self.on_gpu = torch.cuda.is_available()
        device = "cuda" if self.on_gpu else "cpu"
        self.layers = [
            (torch.from_numpy(weight).to(device), torch.from_numpy(bias[:, None]).to(device))
            for weight, bias in zip(weights, biases, strict=True)
        ]
        self.x, self.y = torch.from_numpy(x), torch.from_numpy(y)
        if self.on_gpu:
            for array in (x, y):
                error = int(torch.cuda.cudart().cudaHostRegister(array.ctypes.data, array.nbytes, 0))
                assert error == 0, f"cudaHostRegister: {error}"
            stream = torch.cuda.Stream()
            with torch.cuda.stream(stream):
                for _ in range(3):
                    self._predict()
            torch.cuda.synchronize()
            self.graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(self.graph, stream=stream):
                self._predict()

    @torch.no_grad()
    def _predict(self):
        h = self.x.to(self.layers[0][0].device, non_blocking=True)
        *hidden, (last_weight, last_bias) = self.layers
        for weight, bias in hidden:
            h = torch.baddbmm(bias, h, weight).relu_()
        self.y.copy_(torch.baddbmm(last_bias, h, last_weight), non_blocking=True)

    def __call__(self):
        """Predict y of x."""
        if self.on_gpu:
            self.graph.replay()
            torch.cuda.synchronize()
        else:
            self._predict()


def networks(data_set):
    """Return the ensemble of a data set, with its standardisation folded in."""
    arrays = load_file(FOLDER / f"data-set-{data_set}.safetensors")
    standard = {one.name: arrays.pop(one.name) for one in fields(Standardisation)}
    n_members = len(arrays["bias_0"])
    return Ensemble.from_members(
        [{**{name: array[k] for name, array in arrays.items()}, **standard} for k in range(n_members)]
    )


def main():
    """Evolve, and write what was evaluated."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--sets", default="0,1,2,3,4")
    parser.add_argument("--generations", type=int, default=1000)
    parser.add_argument("--minutes", type=float, default=60.0, help="begin no generation after them")
    parser.add_argument("--workers", type=int, default=15, help="processes that step robots")
    parser.add_argument("--tf32", action="store_true")
    parser.add_argument("--out", type=Path, default=Path())
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    ends = time.time() + 60 * options.minutes
    sets = [int(k) for k in options.sets.split(",")]
    search = Afpo()
    n_designs = search.population_size

    ensembles = [networks(k) for k in sets]
    n_members = ensembles[0].n_members
    members = [*range(n_members), 0]  # the last is the single network
    weights, biases = (
        [np.concatenate([layer[members] for layer in layers]) for layers in zip(*each, strict=True)]
        for each in ([e.weights for e in ensembles], [e.biases for e in ensembles])
    )
    n_networks = len(weights[0])
    names = [(environment, k) for k in sets for environment in ("residual_slush", "single_member")]
    trial_of = np.repeat(np.arange(len(names)), [n_members, 1] * len(sets))  # of each network

    x, y = shared(n_networks, n_designs * N_LINKS, len(OBSERVATION)), shared(n_networks, n_designs * N_LINKS, 3)
    tables, scores = (shared(n_networks, n_designs, n, dtype=np.float64) for n in (N_COLUMNS, 2))
    generation, answered = shared(1, dtype=np.int64), shared(1, dtype=np.int64)
    shares = np.array_split(np.arange(n_networks), min(options.workers, n_networks))
    sent = shared(len(shares), 8, dtype=np.int64)  # a process's requests and generations, in its own cache line

    def exchange(share, requests):
        at = slice(share[0], share[-1] + 1)
        of_robots = (len(share) * n_designs, N_LINKS, -1)
        return at, Exchange(x[at].reshape(of_robots), y[at].reshape(of_robots), requests, answered)

    search.ask(EMPTY_POPULATION, generator(SEED))  # compile before the fork
    answered[0] = 10  # more requests than it has steps, so that nothing waits
    tables[:] = search.ask(EMPTY_POPULATION, generator(SEED)).table
    at, alone = exchange(shares[0], np.zeros(2, np.int64))
    simulate(
        Designs.from_table(tables[at].reshape(-1, N_COLUMNS).copy()),
        ResidualSlush(DEPTH, alone),
        n_settle=2,
        n_measure=2,
    )
    answered[0] = 0
    print(f"compiled, {ends - time.time():.0f} s left", flush=True)
    for i, share in enumerate(shares):  # before CUDA starts, which does not survive a fork
        at, medium = exchange(share, sent[i])
        multiprocessing.get_context("fork").Process(
            target=work, args=(medium, tables[at], generation, scores[at]), daemon=True
        ).start()
    predict = Predictor(weights, biases, x, y, options.tf32)
    print(f"{torch.cuda.get_device_name() if predict.on_gpu else 'CPU'}, {ends - time.time():.0f} s left", flush=True)

    populations = [EMPTY_POPULATION] * len(names)
    record, began, predicting = [], time.time(), 0.0
    while len(record) < options.generations and time.time() < ends:
        number = len(record)
        rngs = [generator(SEED, "evolve", DEPTH, name, k, number) for name, k in names]
        asked = [search.ask(population, rng) for population, rng in zip(populations, rngs, strict=True)]
        tables[:] = np.stack([children.table for children in asked])[trial_of]
        generation[0] += 1
        for _ in range(N_SETTLE + N_MEASURE):
            while sent[:, 0].min() == answered[0]:
                os.sched_yield()
                assert time.time() < ends + 60, "no answer: a process died"
            asked_at = time.perf_counter()
            predict()
            answered[0] += 1
            predicting += time.perf_counter() - asked_at
        while sent[:, 1].min() < generation[0]:
            os.sched_yield()
        record.append(scores.astype(np.float32))
        for i, (children, rng) in enumerate(zip(asked, rngs, strict=True)):
            root, whole = np.moveaxis(record[-1][trial_of == i].astype(np.float64), (2, 1), (0, 1))
            evaluation = Evaluation(penalised_mean(root, disagreement_penalty=1.0), root, whole)
            populations[i] = search.tell(populations[i], children, evaluation, rng)
        if number % 50 == 49:
            best = ", ".join(f"{population.fitness.max():.2f}" for population in populations)
            seconds = time.time() - began
            print(
                f"{number + 1} generations: {seconds:.0f} s, predictions {predicting:.0f} s; best {best} m", flush=True
            )
    scored = np.stack(record)
    for j, k in enumerate(sets):
        first = j * (n_members + 1)
        of_set = scored[:, first : first + n_members + 1].transpose(0, 2, 1, 3)
        tables_of = {"ensemble_table": populations[2 * j].table, "single_table": populations[2 * j + 1].table}
        np.savez_compressed(options.out / f"evolution-{k}.npz", displacement=of_set, **tables_of)
    print(f"{len(record)} generations, {time.time() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
