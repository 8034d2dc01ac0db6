"""Scaling from the simulation to the bench: lengths, times, masses and torques.

With the same gravity and a geometry smaller by λ (0.07), only Froude's law keeps the proportions of all forces. Gravity
and buoyancy scale as M g, quadratic drag as ρ v² L², inertia as M L/T², and T = √λ makes all three scale as M g. Times
shrink by √λ = 0.26, frequencies rise by 3.8, torques scale as M g L. The ratio of the robot's density to the fluid's
must stay the same.

The alternative keeps the simulation's frequencies. Gravity and buoyancy keep their size, while inertia and drag are λ
times weaker relative to them: the robot moves slowly, as if through a thinner slush. The torque of the simulation,
scaled as M g L, is then an upper bound. The paper does not say which law it used: it gives the scale of lengths and
reports whether the robot crosses its tank, not how fast. Froude's law is the default, here and in the virtual tank
(tasks/analysis/tank.py), because the simulation predicts the bench under no other. Kept frequencies suit slow servos.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from tasks.arrays import Floats
from tasks.bench.fabrication.servos import Servo
from tasks.parameters import Parameters
from tasks.world import froude_time

CONTINUOUS_SHARE = 1 / 3  # of its stall torque that a hobby servo sustains without overheating, by a rule of thumb
_SATURATED = 0.999  # share of the simulated motor's maximum torque above which it counts as at its limit


class Scaling(Parameters):
    """Choice of the scaling law."""

    law: Literal["froude", "kept_frequencies"] = "froude"
    """"froude" keeps the proportions of all forces, "kept_frequencies" the frequencies."""
    fluid_density: float = Field(default=1000.0, gt=100.0, le=5000.0)
    """Density of the fluid in the tank [kg/m³]; the paper's gel beads are nearly as dense as water. [P]"""

    def time_scale(self, length: float) -> float:
        """Return bench seconds per second of simulation, for bench metres per metre of simulation."""
        return froude_time(length) if self.law == "froude" else 1.0


@dataclass(frozen=True)
class Scales:
    """Bench units per unit of the simulation."""

    length: float
    time: float
    mass: float

    @property
    def torque(self) -> float:
        """Scale of torques under the same gravity."""
        return self.mass * self.length

    @property
    def frequency(self) -> float:
        """Scale of frequencies and angular speeds."""
        return 1.0 / self.time


def scales_of(scaling: Scaling, *, length: float, mass_kg: float, simulated_mass_kg: float) -> Scales:
    """Compute the scales, from bench metres per metre of simulation and the masses of both robots."""
    return Scales(length=length, time=scaling.time_scale(length), mass=mass_kg / simulated_mass_kg)


@dataclass(frozen=True)
class JointLoad:
    """Load of a joint on its servos over a simulated run, at bench scale."""

    joint: int  # number of the child link
    peak_torque: float  # peak torque of each servo [N·m]
    rms_torque: float  # root mean square torque of each servo [N·m]
    peak_speed: float  # highest speed that the simulated joint reached or its controller commanded [rad/s]
    use: float  # largest share of the torque–speed line in use at once; the servo can't follow above 1
    stall_share: float  # RMS torque as a share of the stall torque
    saturated: float  # share of the steps in which the simulated motor was at its torque limit

    @property
    def margin(self) -> float:
        """Ratio of what the servo can give to what the run needs at the worst instant."""
        return 1.0 / self.use if self.use > 0 else float("inf")


def line_use(torque: Floats, speed: Floats, servo: Servo) -> Floats:
    """Compute the share in use of a servo's straight torque–speed line; it can't follow above 1.

    A motor that drives (torque [N·m] and speed [rad/s] have one sign) loses torque with speed; one that brakes does
    not. The speed must be within the no-load speed in either case.
    """
    driving = np.maximum(np.sign(torque) * speed, 0.0) / servo.no_load_speed_rad_s
    along: Floats = np.abs(torque) / servo.stall_torque_nm + driving
    return np.maximum(along, np.abs(speed) / servo.no_load_speed_rad_s)


def joint_loads(
    joints: tuple[int, ...],
    torque: Floats,
    speed: Floats,
    *,
    scales: Scales,
    servo: Servo,
    servos_per_joint: int,
    max_motor_torque: float,
    commanded_speed: npt.ArrayLike,
) -> list[JointLoad]:
    """Scale the torques and speeds of a simulated run to the bench and compare them with the servos.

    Args:
        joints: (n_joints) numbers of the driven joints.
        torque, speed: (n_steps, n_joints) torques of the simulated motors [N·m] and speeds of the joints [rad/s].
        scales: Scales from simulation to bench.
        servo, servos_per_joint: Servo of every joint, and how many share its torque.
        max_motor_torque: Torque limit of the simulated motors [N·m of simulation].
        commanded_speed: (n_joints) highest speeds commanded [rad/s of simulation], behind which a joint may lag.
    """
    commanded = np.asarray(commanded_speed) * scales.frequency
    asked = torque.astype(np.float64) * scales.torque / servos_per_joint
    turning = speed.astype(np.float64) * scales.frequency
    rms = np.sqrt(np.mean(asked**2, axis=0))
    columns = (
        np.abs(asked).max(axis=0),
        rms,
        np.maximum(np.abs(turning).max(axis=0), commanded),
        np.maximum(line_use(asked, turning, servo).max(axis=0), commanded / servo.no_load_speed_rad_s),
        rms / servo.stall_torque_nm,
        np.mean(np.abs(torque) >= _SATURATED * max_motor_torque, axis=0),
    )
    return [JointLoad(joint, *row) for joint, row in zip(joints, np.transpose(columns).tolist(), strict=True)]
