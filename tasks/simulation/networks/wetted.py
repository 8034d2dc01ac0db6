"""What wetted networks read of a link, and how their outputs act on it, of arrays and of lanes.

tasks/residual/wetted.py has the equations, and the names of the inputs.
"""

from tasks.compiled import formula
from tasks.simd.lanes import Numeric, sqrt
from tasks.world.slush import submerged_part

WETTED_FIELDS = ("length_scale", "y", "cos", "sin", "vx", "vy", "omega")
"""Fields of :class:`tasks.world.LinkStates` that wetted networks read: the arguments of :func:`inputs_of`."""


@formula
def inputs_of(
    a: Numeric, y: Numeric, cos: Numeric, sin: Numeric, vx: Numeric, vy: Numeric, omega: Numeric
) -> tuple[Numeric, ...]:
    """Return the inputs, in the order of WETTED."""
    area, second_moment = submerged_part(a, y, cos, sin)
    width = 1 / a
    share = second_moment * 12 / (width * width + a * a)
    along, across = cos * vy - sin * vx, cos * vx + sin * vy
    speed = sqrt(along * along + across * across)
    squares = abs(along) * along, abs(across) * across
    return area, share, cos, sin, along, across, omega, y, a, speed, abs(omega), squares[0], squares[1]


@formula
def changes_by(outputs: tuple[Numeric, ...], part: tuple[Numeric, ...]) -> tuple[Numeric, Numeric, Numeric]:
    """Return the changes of vx, vy and ω by the outputs f_t, f_n, f_ω and b, and the inputs A_s, J, cos θ and sin θ."""
    area, share, cos, sin = part
    along, across, lift = area * outputs[0], area * outputs[1], area * outputs[3]
    return cos * across - sin * along, (sin * across + cos * along) + lift, share * outputs[2]
