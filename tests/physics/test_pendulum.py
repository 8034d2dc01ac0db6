"""A link on a hinge: the joints of the base simulator against the period of a physical pendulum."""

import numpy as np
import pytest
from links_in_box2d import add_link

from tasks.simulation import reference
from tasks.world import Physics

G, DT = 9.8, 1 / 60


@pytest.mark.parametrize("a", [1.0, 2.0, 3.0])
@pytest.mark.parametrize("theta0", [0.05, 0.8])
def test_the_period_of_a_pendulum(a: float, theta0: float) -> None:
    physics = Physics()
    world = reference.empty_world(physics)
    hinge = world.CreateStaticBody(position=(0.0, 0.0))
    # Hung by its upper end; its long axis points along (-sin θ, cos θ).
    x, y = a / 2 * np.sin(theta0), -a / 2 * np.cos(theta0)
    link = add_link(world, 0.5 / a, a / 2, physics, position=(float(x), float(y)), angle=theta0)
    world.CreateRevoluteJoint(bodyA=hinge, bodyB=link, localAnchorA=(0.0, 0.0), localAnchorB=(0.0, a / 2))

    # T = 2π √(I_hinge / (m g a / 2)) for small swings; for others times the mean of an elliptic integral, of which
    # 1 + θ²/16 + 11 θ⁴/3072 is the series (the next term is under 1e-5 here).
    inertia = (a**2 + a**-2) / 12 + a**2 / 4
    small = 2 * np.pi * np.sqrt(inertia / (G * a / 2))

    angles = [theta0]
    n_periods = 5
    while len(angles) * DT < (n_periods + 1) * small:
        world.Step(physics.time_step, physics.velocity_iterations, physics.position_iterations)
        angles.append(link.angle)
    angle = np.array(angles)
    down = np.flatnonzero((angle[:-1] > 0) & (angle[1:] <= 0))
    crossings = (down + angle[down] / (angle[down] - angle[down + 1])) * DT
    periods = np.diff(crossings)[: n_periods - 1]
    amplitude = np.abs(angle[-int(small / DT) :]).max(), theta0
    longest, shortest = (small * (1 + t**2 / 16 + 11 * t**4 / 3072) for t in (max(amplitude), min(amplitude)))
    # Semi-implicit Euler shifts the frequency by (2π dt / T)² / 24 and interpolation places a crossing within
    # (2π dt / T)² / 8 of a step: together below 3e-4 of a period. Along a circle in steps of ω dt the base simulator is
    # of first order in dt, which shows in the damping; the period lies between those of the first and last amplitude.
    assert (periods < longest * (1 + 3e-4)).all()
    assert (periods > shortest * (1 - 3e-4)).all()
