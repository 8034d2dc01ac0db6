"""Coupled oscillators: each joint's phase is pulled by its load, and by the oscillators of its neighbours.

    target    = A · sin(2π (f t + phase + lead))
    dlead/dt  = load · (target - angle) + coupling · Σ sin(2π (lead of a neighbour - lead))

The neighbours are the joints of the parent and of the children; the children's pull is that of the step before.

The lead, in turns, is what an oscillator is ahead of its genes; it is 0 at first, and of the root, always. A motor that
does not reach its target has a load. The root holds the oscillators of its joints to the common time, and each holds
those beyond: neighbours' phases differ as the genes say where coupling is strong.
"""

from collections.abc import Callable
from typing import Any

from tasks.design.controllers.controller import Controller, gain, register_controller

LOAD, COUPLING = range(2)


def law(joint: Any, sine: Callable[[Any], Any]) -> Any:
    """Return the target angle from rest [rad], the lead after the step [turns], and the pull on the parent's joint."""
    lead = joint.memory
    target = joint.amplitude * sine(joint.periods + joint.phase + lead)
    pull = sine(joint.memory_above - lead)
    rate = joint.gains[LOAD] * (target - joint.angle) + joint.gains[COUPLING] * (pull + joint.told)
    return target, lead + joint.dt * rate, -pull


register_controller(
    Controller(
        "phase",
        law,
        genes=(gain("load", 1.0, "turns/(rad s)"), gain("coupling", 1.0, "turns/s")),
        senses=("angle",),
        remembers=True,
    )
)
