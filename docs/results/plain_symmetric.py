"""Plain networks that learn from the mirror image of every throw, and from its half turn: a form for --with.

It shows how much of what wetted networks save is owed to these copies alone.
"""

from dataclasses import replace

from tasks.residual.forms import register_form
from tasks.residual.forms.plain import PLAIN

register_form(
    replace(
        PLAIN,
        name="plain_symmetric",
        symmetries=[("cos_angle",)],  # half a turn
        mirror=("x", "angle", "vx", "omega"),
    )
)
