"""The operators of variation, compiled: what they do to tables of designs, number by number.

In NumPy a generation's operators are some hundred calls, each of which takes longer than its work on 64 designs; a few
kernels cost little beside the simulation.

An operator draws as much for every design, whether a design needs it or not, and a gene of all designs before the next.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from tasks.arrays import Float64, Int64
from tasks.compiled import inline
from tasks.design.genes import (
    COLUMNS,
    END,
    FIRST,
    HIGH,
    IS_FLAG,
    LINK_OF_COLUMN,
    LOW,
    N_COLUMNS,
    N_JOINTS,
    N_LINKS,
    OF_ROOT,
    PARENT_COLUMN,
    ROOT_PARENT,
    DesignTable,
)

Flags = npt.NDArray[np.bool_]

MOTOR = "motor_on"
MOTORS = COLUMNS[MOTOR].start + 1
"""Column of the first joint's motor; those of the other joints follow. A root has none."""

ANY_NUMBER = -1
"""Of actuated joints: however many there happen to be."""
BODY_STAYS = -1.0
"""In place of a probability that a link is hung from another parent."""


class Numbers(NamedTuple):
    """The numbers that some genes are in a table of designs; every field is (n_numbers,)."""

    column: Int64
    low: Float64
    """In the gene's unit, as ``high``."""
    high: Float64
    is_angle: Flags
    is_flag: Flags
    is_motor: Flags


class Variation(NamedTuple):
    """What may vary, and how."""

    body: DesignTable
    """(1, N_COLUMNS) the design whose body all have; (0, N_COLUMNS) if bodies vary."""
    body_columns: Int64
    """Columns that are of the body."""
    n_actuated: int
    """Joints whose motor is on; ANY_NUMBER for however many there happen to be."""
    numbers: Numbers
    """Those that may change."""
    change: float
    """Probability that a number does."""
    step: float
    """Deviation of the Gaussian step, as a share of the gene's range."""
    rewiring: float
    """Probability that one link of a design is hung from another parent; BODY_STAYS if none may be."""


def random_table(n_designs: int, rng: Generator, variation: Variation) -> DesignTable:
    """Draw designs uniformly within the genes' bounds, with the given body if there is one.

    A motor is on with probability 1/2; where their number is given, any joints are as likely to have them.

    Args:
        n_designs: how many.
        rng: source of randomness.
        variation: what may vary.

    Returns:
        (n_designs, N_COLUMNS)
    """
    table = np.zeros((n_designs, N_COLUMNS))
    for gene in range(len(FIRST)):
        for design in range(n_designs):
            for column in range(FIRST[gene], END[gene]):
                drawn = rng.random()
                if IS_FLAG[gene]:
                    table[design, column] = 1.0 if drawn < 0.5 else 0.0
                else:
                    table[design, column] = LOW[gene] + (HIGH[gene] - LOW[gene]) * drawn
            if not OF_ROOT[gene]:
                table[design, FIRST[gene]] = 0.0  # so that designs that behave alike are equal
    table[:, PARENT_COLUMN] = ROOT_PARENT
    for link in range(1, N_LINKS):
        for design in range(n_designs):
            table[design, PARENT_COLUMN + link] = rng.integers(0, link)
    if variation.n_actuated != ANY_NUMBER:
        for design in range(n_designs):
            _switch_on_highest(table[design, MOTORS : MOTORS + N_JOINTS], rng.random(N_JOINTS), variation.n_actuated)
    if len(variation.body):
        for design in range(n_designs):
            for column in variation.body_columns:
                table[design, column] = variation.body[0, column]
    return table


@inline
def _switch_on_highest(flags: Float64, score: Float64, n: int) -> None:
    """Switch on the n flags of the highest scores, the first of equals, and the others off."""
    for this in range(len(flags)):
        n_before = 0
        for other in range(len(flags)):
            if score[other] > score[this] or (score[other] == score[this] and other < this):
                n_before += 1
        flags[this] = 1.0 if n_before < n else 0.0


def mutate_table(table: DesignTable, rng: Generator, variation: Variation) -> None:
    """Change some numbers of designs, at least one each, and hang some links from another parent, in place.

    Args:
        table: (n_designs, N_COLUMNS)
        rng: source of randomness.
        variation: what may vary, and how.
    """
    numbers = variation.numbers
    n_designs, n_numbers, before = len(table), len(numbers.column), table.copy()
    changes = rng.random((n_designs, n_numbers)) < variation.change
    is_same = np.ones(n_designs, dtype=np.bool_)
    while True:
        steps = rng.standard_normal((n_designs, n_numbers))
        if variation.n_actuated != ANY_NUMBER:
            _move_motors(table, changes, rng, numbers)
        n_same = 0
        for design in range(n_designs):
            if not is_same[design]:
                continue
            for number in range(n_numbers):
                column = numbers.column[number]
                if changes[design, number]:
                    by = steps[design, number] * variation.step
                    table[design, column] = _stepped(numbers, number, table[design, column], by)
                is_same[design] &= table[design, column] == before[design, column]
            n_same += is_same[design]
        if n_same == 0:
            break
        # No gene was drawn, or a bound held those that were: draw one until it moves.
        drawn = rng.integers(0, n_numbers, n_designs)
        changes[:] = False
        for design in range(n_designs):
            changes[design, drawn[design]] = is_same[design]
    if variation.rewiring != BODY_STAYS:
        _rewire(table, rng, variation.rewiring)


@inline
def _stepped(numbers: Numbers, number: int, old: float, by: float) -> float:
    """Move a number by a share of its gene's range, and back within its bounds."""
    low, high = float(numbers.low[number]), float(numbers.high[number])
    if numbers.is_flag[number]:
        return 1.0 - old
    moved = old + by * (high - low)
    if numbers.is_angle[number]:
        moved = low + (moved - low) % (high - low)
    # The bounds also catch the rounding of a remainder just below an angle's end.
    return min(max(moved, low), high)


@inline
def _move_motors(table: DesignTable, changes: Flags, rng: Generator, numbers: Numbers) -> None:
    """Let each motor that is to change change places with one that is its opposite, drawn uniformly; none then is."""
    for number in range(len(numbers.column)):
        if not numbers.is_motor[number]:
            continue
        for design in range(len(table)):
            this, motors = numbers.column[number] - MOTORS, table[design, MOTORS : MOTORS + N_JOINTS]
            chosen, most = this, -1.0
            for other in range(N_JOINTS):
                chance = rng.random()
                if motors[other] != motors[this] and chance > most:
                    chosen, most = other, chance
            if changes[design, number]:
                motors[this], motors[chosen] = motors[chosen], motors[this]
            changes[design, number] = False


@inline
def _rewire(table: DesignTable, rng: Generator, probability: float) -> None:
    """Hang one link of some designs from another of the links before it. Link 1 has the root alone."""
    n_designs = len(table)
    chosen, link, place = rng.random(n_designs), rng.integers(2, N_LINKS, n_designs), rng.random(n_designs)
    for design in range(n_designs):
        if chosen[design] < probability:
            other = np.floor(place[design] * (link[design] - 1))
            column = PARENT_COLUMN + link[design]
            table[design, column] = other + (other >= table[design, column])  # skips the present parent


def recombine_tables(child: DesignTable, other: DesignTable, rng: Generator, variation: Variation) -> None:
    """Give designs some links' genes of others, in place; at least one link comes from each, at least one stays.

    Args:
        child: (n_designs, N_COLUMNS)
        other: as many.
        rng: source of randomness.
        variation: what may vary.
    """
    n_designs = len(child)
    stays = np.empty((n_designs, N_LINKS + 1), dtype=np.bool_)  # each link's genes, and those of the whole design
    of_links = rng.random((n_designs, N_LINKS))
    flipped = rng.integers(0, N_LINKS, n_designs)
    of_whole = rng.random(n_designs)
    on_in = np.empty(N_JOINTS)
    for design in range(n_designs):
        n_stay = 0
        for link in range(N_LINKS):
            stays[design, link] = of_links[design, link] < 0.5
            n_stay += stays[design, link]
        stays[design, N_LINKS] = of_whole[design] < 0.5
        if n_stay == 0 or n_stay == N_LINKS:
            stays[design, flipped[design]] ^= True
        motors = child[design, MOTORS : MOTORS + N_JOINTS]
        for joint in range(N_JOINTS):
            on_in[joint] = motors[joint] + other[design, MOTORS + joint]
        for column in range(N_COLUMNS):
            if not stays[design, LINK_OF_COLUMN[column]]:
                child[design, column] = other[design, column]
        if variation.n_actuated != ANY_NUMBER:
            # 3 on in both, 2 inherited, 1 on in the other, 0 in none; chance decides among equals.
            preference = rng.random(N_JOINTS)
            for joint in range(N_JOINTS):
                preference[joint] += min(on_in[joint], 1.0) + (on_in[joint] == 2.0) + motors[joint]
            _switch_on_highest(motors, preference, variation.n_actuated)
