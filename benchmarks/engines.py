"""Steps of robots: the batch engine, pybox2d and the obvious script."""

from __future__ import annotations

import multiprocessing
import os
import statistics
import time
from functools import partial
from typing import Any

import numpy as np

from benchmarks import obvious
from benchmarks.measure import Benchmark, seconds
from tasks.design import Designs, Morphology, random_designs
from tasks.design.body import kinematic_trees, rigid_bodies
from tasks.simd.lanes import widest
from tasks.simulation import batch, reference, simulate
from tasks.simulation.controller import Controllers
from tasks.simulation.rigid_bodies.engine import Robots
from tasks.simulation.trees.groups import Groups
from tasks.world import DryLand, Environment, Physics, Slush, TrueSlush

WIDEST = widest()
N_DESIGNS = 64
N_STEPS = 1400
N_ROUNDS = 7
_N_GENERATIONS = 20
"""Generations of the batch engine per round."""
_PHYSICS = Physics()
AS_BUILT = Physics(passive_joints="locked", link_collisions=True, max_motor_torque=30.0)
"""Physics of the robot that was built: rigid bodies that collide."""
BUILDABLE = Morphology(n_actuated=2, unjoined_links="apart")


def designs(morphology: Morphology = Morphology()) -> Designs:  # noqa: B008 (it is frozen)
    """Draw the same generation of designs in every call."""
    return random_designs(N_DESIGNS, np.random.default_rng(64), morphology=morphology)


def _batch(designs: Designs, environment: Environment) -> float:
    """Step several generations, as a study does: one takes milliseconds."""
    scene = batch.scene_of(environment, _PHYSICS)
    taken = 0.0
    for _ in range(_N_GENERATIONS):
        groups = Groups(designs, environment.depth, _PHYSICS, environment.medium, n_members=1, n_lanes=WIDEST)
        taken += seconds(partial(groups.advance, scene, 0, N_STEPS, None))
    return taken / _N_GENERATIONS / N_DESIGNS / N_STEPS * 1e6


def _batch_of_bodies(designs: Designs, environment: Environment) -> float:
    robots = Robots(designs, environment.depth, AS_BUILT, environment.medium, n_members=1)
    scene = batch.scene_of(environment, AS_BUILT)
    return seconds(lambda: robots.advance(scene, 0, N_STEPS, None)) / N_DESIGNS / N_STEPS * 1e6


def _bare_steps(designs: Designs, environment: Environment, physics: Physics = _PHYSICS) -> float:
    """Time pybox2d's Step of all robots and nothing else."""
    trees = kinematic_trees(designs, density=physics.link_density)
    controllers = Controllers(designs, physics, environment.depth)
    rigid = rigid_bodies(designs, passive_joints=physics.passive_joints)
    robots = [
        reference._Robot(trees, rigid, design, controllers, environment.depth, physics)
        for design in range(len(designs))
    ]

    def run() -> None:
        for _ in range(N_STEPS):
            for robot in robots:
                robot.world.Step(physics.time_step, physics.velocity_iterations, physics.position_iterations)

    return seconds(run) / len(designs) / N_STEPS * 1e6


def _reference(designs: Designs, environment: Environment) -> float:
    run = partial(simulate, designs, environment, n_settle=0, n_measure=N_STEPS, engine="reference")
    return seconds(run) / len(designs) / N_STEPS * 1e6


def _obvious(designs: Designs, environment: Environment) -> float:
    robots = [obvious.Robot(designs, i, environment.depth, _PHYSICS, Slush()) for i in range(len(designs))]

    def run() -> None:
        for robot in robots:
            for _ in range(N_STEPS):
                robot.step()

    return seconds(run) / len(designs) / N_STEPS * 1e6


def steps() -> list[Benchmark]:
    """Step 64 robots in True Slush from the spawn: the batch engine and its peers.

    The bare Step has neither slush nor motor commands, so its robots lie on the ground.
    """
    figures = []
    population = designs()
    _batch(population, DryLand(0.0))
    for depth, bound in ((0.0, 0.5), (1.0, None), (9.0, 0.35)):
        environment = TrueSlush(depth)
        ours, bare, whole, script = [], [], [], []
        for _ in range(N_ROUNDS):
            ours.append(_batch(population, environment))
            bare.append(_bare_steps(population, environment))
            whole.append(_reference(population, environment))
            script.append(_obvious(population, environment))
        unit = "µs per robot and step"
        figures += [
            Benchmark(f"batch engine, d = {depth:g}", ours, unit, bound),
            Benchmark(f"pybox2d's Step alone, d = {depth:g}", bare, unit),
            Benchmark(f"reference engine, d = {depth:g}", whole, unit),
            Benchmark(f"the obvious script, d = {depth:g}", script, unit),
            Benchmark(f"Step alone over batch, d = {depth:g}", _over(bare, ours), "times", 20.0, at_least=True),
            Benchmark(f"obvious script over batch, d = {depth:g}", _over(script, ours), "times", 400.0, at_least=True),
        ]
    return figures


def bodies() -> list[Benchmark]:
    """Step 64 robots of rigid bodies that collide, with two motors each: the batch engine and pybox2d."""
    figures = []
    population = designs(BUILDABLE)
    _batch_of_bodies(population, DryLand(0.0))
    for depth in (0.0, 9.0):
        environment = TrueSlush(depth)
        ours, bare = [], []
        for _ in range(N_ROUNDS):
            ours.append(_batch_of_bodies(population, environment))
            bare.append(_bare_steps(population, environment, AS_BUILT))
        unit = "µs per robot and step"
        figures += [
            Benchmark(f"batch engine, bodies, d = {depth:g}", ours, unit),
            Benchmark(f"pybox2d's Step alone, bodies, d = {depth:g}", bare, unit),
            Benchmark(f"Step alone over batch, bodies, d = {depth:g}", _over(bare, ours), "times", 3.0, at_least=True),
        ]
    return figures


def _over(theirs: list[float], ours: list[float]) -> list[float]:
    return [a / b for a, b in zip(theirs, ours, strict=True)]


def packing() -> list[Benchmark]:
    """Time the packing of 64 designs, repeated and once after rollouts as in a study, as a share of the rollouts."""
    population, environment = designs(), TrueSlush(9.0)
    scene = batch.scene_of(environment, _PHYSICS)
    pack = partial(Groups, population, environment.depth, _PHYSICS, environment.medium, n_members=1, n_lanes=WIDEST)
    again, once = [], []
    for _ in range(N_ROUNDS):
        groups = pack()
        rollouts = seconds(lambda groups=groups: groups.advance(scene, 0, N_STEPS, None))
        once.append(100 * seconds(pack) / rollouts)
        again.append(100 * statistics.median(seconds(pack) for _ in range(20)) / rollouts)
    name = "packing 64 designs over their rollouts, d = 9"
    return [Benchmark(name, again, "%", 5.0), Benchmark(f"{name}, once after them", once, "%")]


def _work(barrier: Any, results: Any, n_rounds: int) -> None:
    population = designs()
    _batch(population, TrueSlush(1.0))
    barrier.wait()
    start = time.process_time()
    for _ in range(n_rounds):
        _batch(population, TrueSlush(1.0))
    results.put(time.process_time() - start)


def _rate(n_processes: int, n_rounds: int) -> float:
    """Return the rounds that concurrent processes complete per second of CPU time."""
    context = multiprocessing.get_context("spawn")
    barrier, results = context.Barrier(n_processes), context.Queue()
    workers = [context.Process(target=_work, args=(barrier, results, n_rounds)) for _ in range(n_processes)]
    for worker in workers:
        worker.start()
    rate = sum(n_rounds / results.get() for _ in workers)
    for worker in workers:
        worker.join()
    return rate


def two_processes() -> list[Benchmark]:
    """Compare two processes on two cores with one, by CPU time."""
    if (os.cpu_count() or 1) < 2:
        return []
    ratios = [_rate(2, 8) / _rate(1, 8) for _ in range(3)]
    return [Benchmark("two processes over one", ratios, "times", 1.8, at_least=True)]
