"""Morphology: constraints on a design so that it can be built. Paper, "Manufacturing".

The main experiments do not constrain designs. The robot that was built had two motors, and none of its links overlapped
another at rest unless a joint connected them. The operators of variation produce the right number of motors directly.
The other constraints hold by rejection sampling (:func:`sample_allowed`), which preserves an operator's distribution
over the allowed designs; moving links apart would favour the positions that they are moved to.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from tasks.arrays import Bools, Float64, Int64
from tasks.design.body import rest_pose
from tasks.design.controllers import OPEN_LOOP
from tasks.design.gait import swing, top_speed
from tasks.design.gene import DesignError
from tasks.design.genes import LEAST_LINKS, MOST_LINKS, N_LINKS, Designs, DesignTable
from tasks.parameters import Parameters

_TOLERANCE = 1e-9  # overlap that counts as touching [m]: the rounding of positions within some metres

# Most samples of a design: about 9,000 per random design of pontoon, so all are rejected once in 10^50.
MAX_DRAWS = 1 << 20
N_INSTANTS = 24  # of a gait's period in which links must be apart
MAX_BATCH = 4096  # most samples that are drawn together; more overflow the cache


class LinkLimits(Parameters):
    """Numbers of links that a design may have; six by default."""

    least: int = Field(default=N_LINKS, ge=LEAST_LINKS, le=MOST_LINKS)
    """Fewest links, the root among them. [P]"""
    most: int = Field(default=N_LINKS, ge=LEAST_LINKS, le=MOST_LINKS)
    """Most links. Where it exceeds ``least``, mutants may gain or lose a leaf of their tree. [P]"""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.least > self.most:
            raise ValueError(f"least is {self.least}, expected at most {self.most}, which is most: set both")
        return self


class MorphologyRules(Parameters):
    """Constraints on bodies and motors; none by default."""

    n_actuated: int | None = Field(default=None, ge=0, le=MOST_LINKS - 1)
    """Number of joints whose motor is on; which joints is then part of the body, not of the controller. null: each
    motor is on or off, as part of the controller. [P]: 2 in the robot that was built."""
    unjoined_links: Literal["may_overlap", "apart", "apart_in_gait"] = "may_overlap"
    """Whether links that no joint connects may overlap, or are apart at rest, or also while the motors follow the
    controller. [P]: apart in the robot that was built."""
    max_joint_speed: float | None = Field(default=None, gt=0.0, le=1e6)
    """[rad/s]. Highest speed at which a controller may swing a joint; null: no limit."""

    @property
    def constrains_gaits(self) -> bool:
        """Whether a body may have controllers that are not allowed."""
        return self.unjoined_links == "apart_in_gait" or self.max_joint_speed is not None

    @property
    def rejects(self) -> bool:
        """Whether operators of variation may draw designs that are not allowed."""
        return self.unjoined_links != "may_overlap" or self.constrains_gaits

    def of_controllers(self) -> Self:
        """Return the constraints that are left where an allowed body does not vary."""
        return self if self.constrains_gaits else type(self)()

    def allows(self, designs: Designs) -> Bools:
        """Find the designs that meet all constraints but the numbers of motors and links, (n_designs,)."""
        allowed = np.ones(len(designs), dtype=bool)
        if self.max_joint_speed is not None:
            allowed &= np.where(designs.motor_on, top_speed(designs), 0.0).max(axis=1) <= self.max_joint_speed
        if self.unjoined_links != "may_overlap":
            allowed[allowed] = links_apart(designs[allowed])
        if self.unjoined_links == "apart_in_gait":
            allowed[allowed] = apart_in_gait(designs[allowed])
        return allowed


class Morphology(MorphologyRules):
    """Constraints on every design of a trial; six links each are all by default."""

    n_links: LinkLimits = LinkLimits()
    """Limits of the number of links."""

    @model_validator(mode="after")
    def _has_enough_joints(self) -> Self:
        if (self.n_actuated or 0) >= self.n_links.least:
            raise ValueError(
                f"n_actuated is {self.n_actuated}, expected less than n_links.least, {self.n_links.least}: a joint for "
                "each motor"
            )
        return self


ANY_BODY = Morphology()  # no constraints


@dataclass(frozen=True, eq=False)
class Drawn:
    """Designs that a morphology allows, and the number of samples drawn for them."""

    table: DesignTable  # (n_designs, n_columns) accepted designs
    n_draws: Int64  # (n_designs,) samples drawn for each design: n_draws - 1 were rejected
    controller: str = OPEN_LOOP  # of the designs

    @property
    def designs(self) -> Designs:
        """Accepted designs."""
        return Designs.from_table(self.table, self.controller)


def links_apart(designs: Designs) -> Bools:
    """Find the designs in which no two links overlap at rest, except links that a joint connects; (n_designs,).

    Links that touch do not overlap. By the separating axis theorem, two rectangles are apart if a gap separates them
    along an edge of either.
    """
    apart = np.zeros(len(designs), dtype=bool)
    for which, alike in designs.by_number_of_links():
        apart[which] = _links_apart(alike)
    return apart


def _links_apart(designs: Designs) -> Bools:
    x, y, angle = rest_pose(designs)
    half_height, half_width = designs.length_scale / 2, 0.5 / designs.length_scale
    links = np.stack([x, y, np.cos(angle), np.sin(angle), half_width, half_height], axis=1)
    parent = designs.parent
    left = np.arange(len(designs))
    for link in range(2, designs.room):  # a joint connects the root and link 1
        for other in range(link):
            separate = separation(links[:, :, other], links[:, :, link]) >= -_TOLERANCE
            passes = separate | (parent[:, link] == other)
            left, links, parent = left[passes], links[passes], parent[passes]
    apart = np.zeros(len(designs), dtype=bool)
    apart[left] = True
    return apart


def apart_in_gait(designs: Designs) -> Bools:
    """Find the designs whose unconnected links do not overlap while joints follow the controller; (n_designs,).

    Joints with a motor have their target angles, with the range of motion as amplitude; the others are at rest. Gaits
    are looked at in N_INSTANTS instants of a period.
    """
    n = len(designs)
    each = designs[np.repeat(np.arange(n), N_INSTANTS)]
    periods = np.tile(np.arange(N_INSTANTS) / N_INSTANTS, n)[:, None]
    turned = np.where(each.motor_on, swing(each, periods), 0.0)
    apart = links_apart(replace(each, rest_angle=each.rest_angle + turned)).reshape(n, N_INSTANTS)
    return np.asarray(apart.all(axis=1))


def separation(one: Float64, other: Float64) -> Float64:
    """Compute the largest gap between two rectangles along an edge of either; negative where they overlap; (n,) [m].

    Both are (n, 6): x, y of the centre [m]; cosine and sine of the angle; half width, half height [m].
    """
    x1, y1, c1, s1, w1, h1 = one.T
    x2, y2, c2, s2, w2, h2 = other.T
    dx, dy = x2 - x1, y2 - y1
    cos, sin = np.abs(c1 * c2 + s1 * s2), np.abs(s2 * c1 - c2 * s1)  # of the angle between them
    along_one = np.maximum(
        np.abs(c1 * dx + s1 * dy) - (w1 + w2 * cos + h2 * sin), np.abs(c1 * dy - s1 * dx) - (h1 + w2 * sin + h2 * cos)
    )
    along_other = np.maximum(
        np.abs(c2 * dx + s2 * dy) - (w2 + w1 * cos + h1 * sin), np.abs(c2 * dy - s2 * dx) - (h2 + w1 * sin + h1 * cos)
    )
    gap: Float64 = np.maximum(along_one, along_other)
    return gap


def sample_allowed(
    first: DesignTable,
    draw: Callable[[Int64], DesignTable],
    morphology: Morphology,
    *,
    max_draws: int = MAX_DRAWS,
    otherwise: DesignTable | None = None,
    controller: str = OPEN_LOOP,
) -> Drawn:
    """Return designs, sampled until the morphology allows all of them.

    In each round every remaining design gets twice as many samples as before; the first that is allowed is accepted.

    Args:
        first: (n_designs, n_columns) first sample of each design.
        draw: returns a sample for each index that it is given; an index may be repeated.
        morphology: constraints on designs.
        max_draws: most samples per design.
        otherwise: (n_designs, n_columns) designs to return after that many rejections.
        controller: of the designs.
    """
    n_designs = len(first)
    n_draws = np.ones(n_designs, dtype=np.int64)
    found, place = [first], np.arange(n_designs)
    waiting = np.flatnonzero(~morphology.allows(Designs.from_table(first, controller)))
    n_found, n_drawn, each = n_designs, 1, 1
    while waiting.size and n_drawn < max_draws:
        each = max(1, min(2 * each, MAX_BATCH // waiting.size, max_draws - n_drawn))
        drawn = draw(np.repeat(waiting, each))
        allowed = morphology.allows(Designs.from_table(drawn, controller)).reshape(waiting.size, each)
        lucky, chosen = allowed.any(axis=1), allowed.argmax(axis=1)
        n_draws[waiting] += np.where(lucky, chosen + 1, each)
        found.append(drawn[(np.arange(waiting.size) * each + chosen)[lucky]])
        place[waiting[lucky]] = n_found + np.arange(lucky.sum())
        n_found, n_drawn, waiting = n_found + int(lucky.sum()), n_drawn + each, waiting[~lucky]
    if waiting.size:
        if otherwise is None:
            raise DesignError(
                f"design {waiting[0]}: {n_drawn:,} samples were drawn and none is allowed by unjoined_links="
                f"{morphology.unjoined_links} and max_joint_speed={morphology.max_joint_speed}, expected at least one"
            )
        n_draws[waiting] += 1
        found.append(otherwise[waiting])
        place[waiting] = n_found + np.arange(waiting.size)
    return Drawn(np.concatenate(found)[place], n_draws, controller)
