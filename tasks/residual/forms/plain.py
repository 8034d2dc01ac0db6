"""The paper's form: networks know nothing of links, and predict a step's whole residual. Paper, "Residual Physics".

The observation is o = (a, y, cos θ, vx, vy, ω). The horizontal position is left out, because the dynamics do not depend
on x. Only the velocities' residuals act; positions follow by integration.
"""

from typing import Any

from tasks.compiled import formula
from tasks.residual.forms.form import Form, register_form


@formula
def read(links: Any) -> tuple[Any, ...]:
    """Return the inputs of links."""
    return links.length_scale, links.y, links.cos, links.vx, links.vy, links.omega


@formula
def act(outputs: Any, inputs: Any) -> tuple[Any, Any, Any]:  # noqa: ARG001
    """Return the changes of vx, vy and ω, which are the outputs."""
    return outputs[0], outputs[1], outputs[2]


PLAIN = register_form(
    Form(
        name="plain",
        inputs=("a", "y", "cos_angle", "vx", "vy", "omega"),  # [m, m, 1, m/s, m/s, rad/s]
        read=read,
        beside=("x", "y", "angle"),
        outputs=("vx", "vy", "omega"),
        act=act,
    )
)
