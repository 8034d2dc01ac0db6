"""What a controller is: genes of its own, and a law from what a joint senses to its target angle.

Every robot has a frequency, and each of its joints an amplitude and a phase; a law may use them or not. It is one text
for numbers, arrays and the batch engine's lanes: operators, ``abs`` and the functions of ``tasks.simd.lanes`` such as
``select`` in place of a branch. Both engines, MuJoCo, servos and checks of gaits call it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from tasks.design.gene import DesignError, Gene
from tasks.discovery import register


class Joint(NamedTuple):
    """What a law knows of a joint at the start of a step; its link is the child. What is sensed begins with angle."""

    periods: Any  # f t, time in periods of the robot's frequency
    amplitude: Any  # the gene motion_range [rad]
    phase: Any  # the gene phase [turns]
    gains: Any  # the controller's own genes, by index
    dt: Any = None  # time step [s]
    memory: Any = None  # what the law returned to be remembered in the step before; 0 at first
    memory_above: Any = None  # the same of the parent's joint; 0 where the parent is the root
    told: Any = None  # sum of what the joints of the link's children told in the step before; 0 at first
    angle: Any = None  # of the joint, from rest [rad]
    speed: Any = None  # of the joint [rad/s]
    cos: Any = None  # cosine of the angle between the link's long axis and the vertical
    sin: Any = None  # sine of the same angle
    spin: Any = None  # angular velocity of the link [rad/s]
    wet: Any = None  # share of the link below y = 0, whatever the medium, dry land included
    contact: Any = None  # 1 where the link touches the ground, else 0


SENSES = Joint._fields[Joint._fields.index("angle") :]

OPEN_LOOP = "open_loop"  # the paper's controller

Law = Callable[[Any, Callable[[Any], Any]], Any]


@dataclass(frozen=True)
class Controller:
    """A controller; its genes are named ``controller.gene`` in tables and files."""

    name: str
    law: Law
    """Returns the target angle from rest [rad] of a :class:`Joint`, given the sine of angles in turns; with
    ``remembers``, that, a number to remember, and one to tell the parent's joint."""
    genes: tuple[Gene, ...] = ()  # of each joint
    senses: tuple[str, ...] = ()  # what the law reads of SENSES
    remembers: bool = False

    @property
    def needs(self) -> str:
        """What the law needs beside the time, in words."""
        senses = dict.fromkeys("tilt" if sense in ("cos", "sin") else sense for sense in self.senses)
        return ", ".join((*senses, *(("a memory",) if self.remembers else ())))

    @property
    def is_blind(self) -> bool:
        """Whether its gait is known beforehand."""
        return not self.needs


CONTROLLERS: dict[str, Controller] = {}  # controllers by name


def gain(name: str, largest: float, unit: str) -> Gene:
    """Return a gene of each joint within ± largest, which a mutation may set to 0."""
    return Gene(name, "control", "gain", -largest, largest, unit, of_root=False)


def _try_law(controller: Controller) -> None:
    """Raise ValueError if a law fails for two joints at once, or does not return what it should."""
    two = np.array((0.5, -0.5), np.float32)
    lacks = {field for field in SENSES if field not in controller.senses}
    lacks |= set() if controller.remembers else {"memory", "memory_above", "told"}
    lacks |= {"dt"} if controller.is_blind else set()
    joint = {field: two for field in Joint._fields if field not in lacks} | {"gains": [two] * len(controller.genes)}
    try:
        found = controller.law(SimpleNamespace(**joint), np.sin)
        parts = found if isinstance(found, tuple) else (found,)
        if len(parts) != (3 if controller.remembers else 1) or any(np.shape(part) not in ((), (2,)) for part in parts):
            wanted = (
                "an angle, a number to remember and one to tell its parent's" if controller.remembers else "an angle"
            )
            raise TypeError(f"expected of each joint {wanted}, got {found}")
    except AttributeError as error:
        wanted = "a field of Joint"
        if error.name in lacks:
            wanted = "it among its senses" if error.name in SENSES else "remembers=True"
        raise ValueError(f"controller {controller.name!r}: its law reads {error.name}, expected {wanted}") from None
    except Exception as error:
        raise ValueError(f"controller {controller.name!r}: its law failed: {error}") from error


def register_controller(controller: Controller) -> None:
    """Add a controller to the registry.

    Raises:
        ValueError: another controller has the name, it has no genes by which tables know its designs or some that are
            no gains, or the law fails, returns something else, or reads what ``senses`` and ``remembers`` lack.
    """
    name = controller.name
    if not controller.genes and name != OPEN_LOOP:
        raise ValueError(f"controller {name!r}: expected at least one gene of its own, by which files know its designs")
    if not name.isidentifier() or len({gene.name for gene in controller.genes}) < len(controller.genes):
        raise ValueError(f"controller {name!r}: expected a name without dots, and genes that have different ones")
    if wrong := [gene.name for gene in controller.genes if not (gene.per_link and np.isfinite(gene.high - gene.low))]:
        raise ValueError(f"controller {name!r}: {wrong[0]}: expected a gene of each joint, with finite bounds")
    _try_law(controller)
    genes = tuple(replace(gene, name=f"{name}.{gene.name}") for gene in controller.genes)
    register(CONTROLLERS, "controller", name, replace(controller, genes=genes))


def controller_named(name: str) -> Controller:
    """Return a controller; raise DesignError if there is none of the name."""
    if name not in CONTROLLERS:
        known = ", ".join(CONTROLLERS)
        raise DesignError(f"controller: expected any of {known}, or of yours that --with names, got {name!r}")
    return CONTROLLERS[name]
