"""Engines: what simulates robots, and throws links into the fluids that only it knows.

Another simulator is one file, of yours (``--with``) or in the package: it registers its engine, and the medium of its
fluid, if it has one, which names the engine (:class:`tasks.world.medium.NativeFluid`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from tasks import discovery
from tasks.arrays import Float32, Floats
from tasks.simulation import batch, mujoco, reference
from tasks.simulation.box2d import Motion
from tasks.simulation.free_links import FreeLinks
from tasks.simulation.mujoco import EngineError
from tasks.world import Medium, MediumWithMemory, Physics
from tasks.world.medium import MediumInRollout

EngineName: TypeAlias = str


Step: TypeAlias = Callable[[Float32], Float32]  # from (n_links, 6) states to those a step of the physics later


def _in_box2d(length_scale: Floats, physics: Physics, medium: Medium | MediumWithMemory) -> Step:
    links, around = FreeLinks(length_scale, physics), MediumInRollout(medium, np.inf)
    return lambda state: links.step(state, around)


@dataclass(frozen=True)
class Engine:
    """A simulator."""

    roll_out: Callable[..., Motion]  # with the arguments of tasks.simulation.batch.roll_out
    free_links: Callable[[Floats, Physics, Any], Step] = _in_box2d  # links of these long axes [m] in a medium


ENGINES: dict[EngineName, Engine] = {}
BOX2D: tuple[EngineName, ...] = ("batch", "reference")  # the engines that have the same bits


def register_engine(name: EngineName, engine: Engine) -> None:
    """Add an engine; raise ValueError if the name is taken."""
    discovery.register(ENGINES, "engine", name, engine)


register_engine("batch", Engine(batch.roll_out))
register_engine("reference", Engine(reference.roll_out))
register_engine("mujoco", Engine(mujoco.roll_out, mujoco.free_links))


def engine_in(medium: Medium | MediumWithMemory | None, engine: EngineName = "batch") -> EngineName:
    """Return the engine that simulates a medium: the given one, or its own in place of Box2D."""
    return getattr(medium, "engine", engine) if engine in BOX2D else engine


def engine_named(name: EngineName) -> Engine:
    """Return the engine of a name; raise EngineError if there is none."""
    if name not in ENGINES:
        raise EngineError(f"engine is {name!r}, expected any of {', '.join(ENGINES)}")
    return ENGINES[name]


def links_in(medium: Medium | MediumWithMemory, length_scale: Floats, physics: Physics) -> Step:
    """Return what takes a step with (n_links,) free links of these long axes [m], in the medium's engine."""
    return engine_named(engine_in(medium)).free_links(length_scale, physics, medium)
