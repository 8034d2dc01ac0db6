"""Morphology: what a body must keep to so that it can be built. Paper, "Manufacturing".

The main experiments ask nothing of a body. The robot that was built had two actuated joints, and none of its links
overlapped another at rest unless a joint tied the two.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from tasks.design.genes import N_LINKS
from tasks.parameters import Parameters


class Morphology(Parameters):
    """What every design of a trial keeps to; nothing by default."""

    n_actuated: int | None = Field(default=None, ge=0, le=N_LINKS - 1)
    """Joints whose motor is on, exactly; which they are then belongs to the body and not to the controller. null lets
    every motor be on or off, as a part of the controller. [P]: 2 in the robot that was built."""
    unjoined_links: Literal["may_overlap", "apart"] = "may_overlap"
    """Whether links that no joint ties to each other may overlap at rest. [P]: apart in the robot that was built."""


ANY_BODY = Morphology()
"""Asks nothing."""
