"""Compiled operators of variation on tables of designs.

In NumPy the operators of a generation would be a hundred calls, each slower than its work on 64 designs; the kernels
cost little compared to the simulation.

An operator draws the same number of random numbers for every design, needed or not, and a gene of all designs before
the next gene.
"""

from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from tasks.arrays import Bools, Float64, Int64
from tasks.compiled import inline
from tasks.design.genes import COLUMNS, N_JOINTS, N_LINKS, PARENT_COLUMN, ROOT_PARENT, DesignTable, GeneColumns

MOTOR = "motor_on"
MOTORS = COLUMNS[MOTOR].start + 1  # column of the first joint's motor, followed by those of the other joints

ANY_NUMBER = -1  # number of motors that are on: unconstrained
GAIN_OFF = 0.25  # deviations of a Gaussian step: 20 % of steps are smaller
BODY_STAYS = -1.0  # stands for a probability of rewiring if bodies must not change


class Variation(NamedTuple):
    """What may vary, and the rates of variation."""

    of: GeneColumns  # what the columns of the tables hold
    body: DesignTable  # (1, n_columns) design whose body all designs get; (0, n_columns) if bodies vary
    body_columns: Int64  # columns of the body
    n_actuated: int  # number of motors that are on, or ANY_NUMBER
    columns: Int64  # columns that may change
    change: float  # probability that a number does
    step: float  # deviation of the Gaussian step, as a share of the gene's range
    rewiring: float  # probability that one link of a design gets another parent, or BODY_STAYS


def random_table(n_designs: int, rng: Generator, variation: Variation) -> DesignTable:
    """Return (n_designs, n_columns) designs, uniform within the genes' bounds.

    A motor is on with probability 1/2; if their number is given, all sets of joints are equally likely. A gain is 0
    with probability 1/2.
    """
    of = variation.of
    table = np.zeros((n_designs, len(of.low)))
    for gene in range(len(of.first)):
        for design in range(n_designs):
            for column in range(of.first[gene], of.end[gene]):
                drawn = rng.random()
                if of.is_ignored[column] or (of.is_gain[column] and drawn < 0.5):
                    table[design, column] = 0.0  # designs that behave alike are equal
                elif of.is_flag[column]:
                    table[design, column] = 1.0 if drawn < 0.5 else 0.0
                else:
                    share = 2.0 * drawn - 1.0 if of.is_gain[column] else drawn
                    table[design, column] = of.low[column] + (of.high[column] - of.low[column]) * share
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
    """Set the n flags with the highest scores, the first among equals, and clear the others."""
    for this in range(len(flags)):
        n_before = 0
        for other in range(len(flags)):
            if score[other] > score[this] or (score[other] == score[this] and other < this):
                n_before += 1
        flags[this] = 1.0 if n_before < n else 0.0


def mutate_table(table: DesignTable, rng: Generator, variation: Variation) -> None:
    """Change at least one number of each design, and rewire some designs, in place."""
    columns = variation.columns
    n_designs, n_numbers, before = len(table), len(columns), table.copy()
    changes = rng.random((n_designs, n_numbers)) < variation.change
    is_same = np.ones(n_designs, dtype=np.bool_)
    while True:
        steps = rng.standard_normal((n_designs, n_numbers))
        if variation.n_actuated != ANY_NUMBER:
            _move_motors(table, changes, rng, columns)
        n_same = 0
        for design in range(n_designs):
            if not is_same[design]:
                continue
            for number in range(n_numbers):
                column = columns[number]
                if changes[design, number]:
                    old, step = table[design, column], steps[design, number]
                    table[design, column] = _stepped(column, old, step, variation)
                is_same[design] &= table[design, column] == before[design, column]
            n_same += is_same[design]
        if n_same == 0:
            break
        # Designs that are unchanged, because no gene was drawn or a bound held it: draw one gene until it changes.
        drawn = rng.integers(0, n_numbers, n_designs)
        changes[:] = False
        for design in range(n_designs):
            changes[design, drawn[design]] = is_same[design]
    if variation.rewiring != BODY_STAYS:
        _rewire(table, rng, variation.rewiring)


@inline
def _stepped(column: int, old: float, step: float, variation: Variation) -> float:
    """Move a number by a share of its gene's range, and return it to its bounds; a small step turns a gain off."""
    of = variation.of
    low, high = float(of.low[column]), float(of.high[column])
    if of.is_flag[column]:
        return 1.0 - old
    if of.is_gain[column] and old != 0.0 and abs(step) < GAIN_OFF:
        return 0.0
    moved = old + step * variation.step * (high - low)
    if of.is_angle[column]:
        moved = low + (moved - low) % (high - low)
    # The remainder may round to the angle's end.
    return min(max(moved, low), high)


@inline
def _move_motors(table: DesignTable, changes: Bools, rng: Generator, columns: Int64) -> None:
    """Swap each motor that changes with a random motor in the opposite state, and clear its change."""
    for number in range(len(columns)):
        this = columns[number] - MOTORS
        if not 0 <= this < N_JOINTS:
            continue
        for design in range(len(table)):
            motors = table[design, MOTORS : MOTORS + N_JOINTS]
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
    """Give one link of some designs another parent. Link 1 can have no other than the root."""
    n_designs = len(table)
    chosen, link, share = rng.random(n_designs), rng.integers(2, N_LINKS, n_designs), rng.random(n_designs)
    for design in range(n_designs):
        if chosen[design] < probability:
            other = np.floor(share[design] * (link[design] - 1))
            column = PARENT_COLUMN + link[design]
            table[design, column] = other + (other >= table[design, column])  # skips its parent


def recombine_tables(child: DesignTable, other: DesignTable, rng: Generator, variation: Variation) -> None:
    """Replace the genes of some links, at least one and not all, by those of other designs, in place."""
    n_designs = len(child)
    stays = np.empty((n_designs, N_LINKS + 1), dtype=np.bool_)  # genes of each link, and of the whole design
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
        for column in range(child.shape[1]):
            if not stays[design, variation.of.link[column]]:
                child[design, column] = other[design, column]
        if variation.n_actuated != ANY_NUMBER:
            # 3: on in both parents, 2: inherited, 1: on in the other parent, 0: off in both; ties are random.
            preference = rng.random(N_JOINTS)
            for joint in range(N_JOINTS):
                preference[joint] += min(on_in[joint], 1.0) + (on_in[joint] == 2.0) + motors[joint]
            _switch_on_highest(motors, preference, variation.n_actuated)
