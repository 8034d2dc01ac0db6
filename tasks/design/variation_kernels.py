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
from tasks.design.genes import FIRST, NO_LINK, DesignTable, GeneColumns, count_links

MOTOR = "motor_on"
_FIRST_MOTOR = FIRST[MOTOR]

ANY_NUMBER = -1  # number of motors that are on: unconstrained
GAIN_OFF = 0.25  # deviations of a Gaussian step: 20 % of steps are smaller
BODY_STAYS = -1.0  # stands for a probability of rewiring if bodies must not change


class Variation(NamedTuple):
    """What may vary, and the rates of variation."""

    of: GeneColumns  # what the columns of the tables hold
    least: int  # fewest links of a design
    most: int  # most links
    body: DesignTable  # (1, n_columns) design whose body all designs get; (0, n_columns) if bodies vary
    body_columns: Int64  # columns of the body
    n_actuated: int  # number of motors that are on, or ANY_NUMBER
    columns: Int64  # columns that may change
    change: Float64  # (room + 1,) probability that a number does, by the design's number of links
    step: float  # deviation of the Gaussian step, as a share of the gene's range
    rewiring: float  # probability that one link of a design gets another parent, or BODY_STAYS
    resizing: float  # probability that a design gains or loses a leaf, if limits leave a choice


@inline
def _links_of(genes_of: Float64, of: GeneColumns) -> int:
    """Count the links of a design, a row of a table."""
    return count_links(genes_of[of.parent : of.parent + of.room])


@inline
def _motors_of(genes_of: Float64, of: GeneColumns) -> Float64:
    """View the flags of the motors of a design's joints."""
    first = _FIRST_MOTOR * of.room
    return genes_of[first + 1 : first + _links_of(genes_of, of)]


def random_table(n_designs: int, rng: Generator, variation: Variation) -> DesignTable:
    """Return (n_designs, n_columns) designs, uniform within the genes' bounds and the number of links within its own.

    A motor is on with probability 1/2; if their number is given, all sets of joints are equally likely. A gain is 0
    with probability 1/2.
    """
    of = variation.of
    table = _random_genes(n_designs, rng, of)
    n_links = np.full(n_designs, variation.most)
    if len(variation.body) > 0:
        n_links[:] = _links_of(variation.body[0], of)
    elif variation.least < variation.most:
        n_links[:] = rng.integers(variation.least, variation.most + 1, n_designs)
    for link in range(1, of.room):
        for design in range(n_designs):
            parent = rng.integers(0, link)
            if link < n_links[design]:
                table[design, of.parent + link] = parent
    for design in range(n_designs):
        for column in range(len(of.low)):
            if of.link[column] >= n_links[design] and not of.is_parent[column]:
                table[design, column] = 0.0
    if variation.n_actuated != ANY_NUMBER:
        for design in range(n_designs):
            score = rng.random(of.room - 1)
            _switch_on_highest(_motors_of(table[design], of), score, variation.n_actuated)
    if len(variation.body):
        for design in range(n_designs):
            for column in variation.body_columns:
                table[design, column] = variation.body[0, column]
    return table


@inline
def _random_genes(n_designs: int, rng: Generator, of: GeneColumns) -> DesignTable:
    """Return a table of random genes of as many links as it has room for, without parents."""
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
    table[:, of.parent : of.parent + of.room] = NO_LINK
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
    of, columns = variation.of, variation.columns
    n_designs, n_numbers, before = len(table), len(columns), table.copy()
    drawn = rng.random((n_designs, n_numbers))
    n_links, changes = np.empty(n_designs, np.int64), np.empty((n_designs, n_numbers), np.bool_)
    for design in range(n_designs):
        n_links[design] = _links_of(table[design], of)
        changes[design] = drawn[design] < variation.change[n_links[design]]
    is_same = np.ones(n_designs, dtype=np.bool_)
    while True:
        steps = rng.standard_normal((n_designs, n_numbers))
        if variation.n_actuated != ANY_NUMBER:
            _move_motors(table, changes, rng, variation)
        n_same = 0
        for design in range(n_designs):
            if not is_same[design]:
                continue
            for number in range(n_numbers):
                column = columns[number]
                if changes[design, number] and of.link[column] < n_links[design]:
                    old, step = table[design, column], steps[design, number]
                    table[design, column] = _stepped(column, old, step, variation)
                is_same[design] &= table[design, column] == before[design, column]
            n_same += is_same[design]
        if n_same == 0:
            break
        # Designs that are unchanged, because no gene was drawn or a bound held it: draw one gene until it changes.
        changed = rng.integers(0, n_numbers, n_designs)
        changes[:] = False
        for design in range(n_designs):
            changes[design, changed[design]] = is_same[design]
    if variation.rewiring != BODY_STAYS:
        _rewire(table, rng, variation)
        if variation.least < variation.most:
            _resize(table, rng, variation)


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
def _move_motors(table: DesignTable, changes: Bools, rng: Generator, variation: Variation) -> None:
    """Swap each motor that changes with a random motor in the opposite state, and clear its change."""
    of = variation.of
    for number in range(len(variation.columns)):
        this = variation.columns[number] - _FIRST_MOTOR * of.room - 1
        if not 0 <= this < of.room - 1:
            continue
        for design in range(len(table)):
            motors = _motors_of(table[design], of)
            chosen, most = this, -1.0
            for other in range(of.room - 1):
                chance = rng.random()
                is_other = max(this, other) < len(motors) and motors[other] != motors[this]
                if is_other and chance > most:
                    chosen, most = other, chance
            if changes[design, number] and this < len(motors):
                motors[this], motors[chosen] = motors[chosen], motors[this]
            changes[design, number] = False


@inline
def _rewire(table: DesignTable, rng: Generator, variation: Variation) -> None:
    """Give one link of some designs another parent. Link 1 can have no other than the root."""
    n_designs, of = len(table), variation.of
    chosen, link = rng.random(n_designs), np.empty(n_designs, np.int64)
    for design in range(n_designs):
        link[design] = rng.integers(2, max(_links_of(table[design], of), 3))
    share = rng.random(n_designs)
    for design in range(n_designs):
        if chosen[design] < variation.rewiring and link[design] < _links_of(table[design], of):
            other = np.floor(share[design] * (link[design] - 1))
            column = of.parent + link[design]
            table[design, column] = other + (other >= table[design, column])  # skips its parent


@inline
def _resize(table: DesignTable, rng: Generator, variation: Variation) -> None:
    """Add a random leaf to some designs, and remove one of some others, as far as the limits allow."""
    n_designs, of = len(table), variation.of
    chosen, share, new = rng.random(n_designs), rng.random(n_designs), _random_genes(n_designs, rng, of)
    for design in range(n_designs):
        genes_of, n_links = table[design], _links_of(table[design], of)
        preference = rng.random(of.room - 1)
        if chosen[design] < variation.resizing / 2 and n_links < variation.most:
            for column in range(len(of.low)):
                if of.link[column] == n_links:
                    genes_of[column] = new[design, column]
            genes_of[of.parent + n_links] = np.floor(share[design] * n_links)
            if variation.n_actuated != ANY_NUMBER:
                genes_of[_FIRST_MOTOR * of.room + n_links] = 0.0
        elif variation.resizing / 2 <= chosen[design] < variation.resizing and n_links > variation.least:
            _remove_leaf(genes_of, n_links, share[design], of)
        if variation.n_actuated != ANY_NUMBER:  # motors that are on stay on, and one takes the place of the leaf's
            motors = _motors_of(genes_of, of)
            for joint in range(len(motors)):
                preference[joint] += motors[joint]
            _switch_on_highest(motors, preference, variation.n_actuated)


@inline
def _remove_leaf(genes_of: Float64, n_links: int, share: float, of: GeneColumns) -> None:
    """Remove one of a design's leaves, by a share of their number; the links after it move up."""
    parent = genes_of[of.parent : of.parent + of.room]
    is_leaf = np.ones(n_links, np.bool_)
    is_leaf[0] = False
    for link in range(1, n_links):
        is_leaf[int(parent[link])] = False
    place = int(share * is_leaf.sum())
    leaf = np.flatnonzero(is_leaf)[place]
    for link in range(1, n_links):
        parent[link] -= parent[link] > leaf
    for column in range(len(of.low)):
        link = of.link[column]
        if leaf <= link < n_links - 1:
            genes_of[column] = genes_of[column + 1]
        elif link == n_links - 1:
            genes_of[column] = NO_LINK if of.is_parent[column] else 0.0


def recombine_tables(child: DesignTable, other: DesignTable, rng: Generator, variation: Variation) -> None:
    """Replace the genes of some links, at least one and not all, by those of other designs, in place.

    Links that only one design of a pair has are one choice: the child has all of them or none.
    """
    n_designs, of = len(child), variation.of
    n_joints = of.room - 1
    stays = np.empty((n_designs, of.room + 1), dtype=np.bool_)  # genes of each link, and of the whole design
    of_links, flipped = rng.random((n_designs, of.room)), np.empty(n_designs, np.int64)
    for design in range(n_designs):
        n_shared = min(_links_of(child[design], of), _links_of(other[design], of))
        flipped[design] = rng.integers(0, n_shared)
    of_whole = rng.random(n_designs)
    of_rest = rng.random(n_designs) if variation.least < variation.most else of_whole
    on_in = np.empty(n_joints)
    for design in range(n_designs):
        n_stay, n_shared = 0, min(_links_of(child[design], of), _links_of(other[design], of))
        for link in range(n_shared):
            stays[design, link] = of_links[design, link] < 0.5
            n_stay += stays[design, link]
        stays[design, n_shared : of.room] = of_rest[design] < 0.5
        stays[design, of.room] = of_whole[design] < 0.5
        if n_stay == 0 or n_stay == n_shared:
            stays[design, flipped[design]] ^= True
        first = _FIRST_MOTOR * of.room + 1
        for joint in range(n_joints):
            on_in[joint] = child[design, first + joint] + other[design, first + joint]
        for column in range(child.shape[1]):
            if not stays[design, of.link[column]]:
                child[design, column] = other[design, column]
        if variation.n_actuated != ANY_NUMBER:
            # 3: on in both parents, 2: inherited, 1: on in the other parent, 0: off in both; ties are random.
            preference, motors = rng.random(n_joints), _motors_of(child[design], of)
            for joint in range(len(motors)):
                preference[joint] += min(on_in[joint], 1.0) + (on_in[joint] == 2.0) + motors[joint]
            _switch_on_highest(motors, preference, variation.n_actuated)
