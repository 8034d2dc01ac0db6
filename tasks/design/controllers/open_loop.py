"""The paper's controller: an oscillator for each joint, blind to all but time. Paper, "Evolutionary Design"."""

from collections.abc import Callable
from typing import Any

from tasks.compiled import formula
from tasks.design.controllers.controller import OPEN_LOOP, Controller, register_controller


@formula
def swing(joint: Any, sine: Callable[[Any], Any]) -> Any:
    """Return A · sin(2π (f t + phase)) [rad]."""
    return joint.amplitude * sine(joint.periods + joint.phase)


register_controller(Controller(OPEN_LOOP, swing))
