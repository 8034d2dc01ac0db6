"""The table of genes: their bounds and units. Paper, "Evolutionary Design"."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

GenePart = Literal["body", "control"]
Kind = Literal["interval", "angle", "flag", "gain"]


class DesignError(ValueError):
    """An invalid design; the message names design and gene, the expected and the received value."""


@dataclass(frozen=True)
class Gene:
    """One row of the table of genes.

    An ``interval`` is clipped to [low, high]; an ``angle`` wraps around at high, where it equals low; a ``flag`` is
    False or True; a ``gain`` is an interval that half of the random designs and some mutations set to 0.
    """

    name: str
    part: GenePart
    kind: Kind
    low: float
    high: float
    unit: str
    of_root: bool  # whether the root has this gene too
    per_link: bool = True  # whether each link has one; otherwise the design has one


GENES: tuple[Gene, ...] = (
    #    name                 part       kind        low     high         unit             of_root
    Gene("length_scale", "body", "interval", 1.0, 3.0, "m", True),
    Gene("parent_attachment", "body", "interval", -1.0, 1.0, "half heights", False),
    Gene("child_attachment", "body", "interval", -1.0, 1.0, "half heights", False),
    Gene("rest_angle", "body", "angle", -np.pi, np.pi, "rad", False),
    Gene("phase", "control", "angle", 0.0, 2.0 * np.pi, "rad", False),
    Gene("motion_range", "control", "interval", 0.2, np.pi / 2.0, "rad", False),
    Gene("motor_on", "control", "flag", 0.0, 1.0, "", False),
    Gene("frequency", "control", "interval", 0.0, 0.3, "Hz", True, per_link=False),
)
"""The genes of every design except the tree (``parent``), which :func:`tasks.design.variation.mutate` rewires. A
controller adds its own (:mod:`tasks.design.controllers`)."""

PER_DESIGN = tuple(gene.name for gene in GENES if not gene.per_link)  # fields with one number per design
