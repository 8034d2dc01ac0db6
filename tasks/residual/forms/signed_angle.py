"""Plain networks that see sin θ, too: which way a link leans.

A medium that pushes a tilted plate sideways, to a side that depends on the sign of its angle, requires it.
"""

from dataclasses import replace
from typing import Any

from tasks.compiled import formula
from tasks.residual.forms.form import register_form
from tasks.residual.forms.plain import PLAIN


@formula
def read(links: Any) -> tuple[Any, ...]:
    """Return the inputs of links."""
    return links.length_scale, links.y, links.cos, links.vx, links.vy, links.omega, links.sin


register_form(replace(PLAIN, name="signed_angle", inputs=(*PLAIN.inputs, "sin_angle"), read=read))
