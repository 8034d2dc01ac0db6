"""From the simulation's scale to the bench's: what a length, a second, a kilogram and a torque become.

With the same gravity and a geometry smaller by λ (0.07), all forces of the simulation keep their proportions under
Froude's law alone: gravity and buoyancy go as M g, a drag that is quadratic in speed as ρ v² L², inertia as M L/T²,
and T = √λ makes all three go as M g. Times shrink by √λ = 0.26, frequencies rise by 3.8, torques go as M g L. It asks
for the same ratio of the robot's density to the fluid's.

The other choice keeps the simulation's frequencies, one second for one second. Gravity and buoyancy keep their size,
while inertia and drag are λ times weaker beside them than in the simulation: the robot moves as if through a thinner
slush, slowly. What torque the simulation asked, scaled as M g L, is then an upper bound. The paper does not say which
it chose: it gives the scale of lengths, and compares whether the robot crosses its tank, not how fast. Froude's law is
the default, here and in the virtual tank (tasks/analysis/tank.py), because under it alone the simulated motion is a
prediction. Kept frequencies are for servos too slow for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from tasks.arrays import Floats
from tasks.fabrication.servos import Servo
from tasks.parameters import Parameters
from tasks.world import froude_time

Law = Literal["froude", "kept_frequencies"]

HOT = 1 / 3
"""Share of its stall torque that a hobby servo bears on average without overheating: a rule of thumb of the trade."""

SATURATED = 0.999
"""Share of the simulated motor's greatest torque above which it counts as at its limit."""


class Scaling(Parameters):
    """How the bench follows from the simulation."""

    law: Law = "froude"
    """"froude" keeps the proportions of all forces; "kept_frequencies" lets a second stay a second."""
    fluid_density: float = Field(default=1000.0, gt=100.0, le=5000.0)
    """Of what fills the tank [kg/m³]; the paper's gel beads are nearly as dense as water. [P]"""


@dataclass(frozen=True)
class Scales:
    """What the bench has for one of the simulation's units."""

    length: float
    """[m]"""
    time: float
    """[s]"""
    mass: float
    """[kg], of the robot as it is built, everything included."""

    @property
    def torque(self) -> float:
        """[N·m], under the same gravity: mass times length."""
        return self.mass * self.length

    @property
    def frequency(self) -> float:
        """[Hz], and as much for an angular speed [rad/s]."""
        return 1.0 / self.time


def scales_of(scaling: Scaling, *, length: float, mass_kg: float, simulated_mass_kg: float) -> Scales:
    """Tie the bench to the simulation.

    Args:
        scaling: which law.
        length: bench metres for a metre of simulation.
        mass_kg: of the robot that is built.
        simulated_mass_kg: of the one that was simulated.
    """
    time = froude_time(length) if scaling.law == "froude" else 1.0
    return Scales(length=length, time=time, mass=mass_kg / simulated_mass_kg)


@dataclass(frozen=True)
class JointLoad:
    """What one joint asks of its servos over a whole simulated run, on the bench's scale."""

    joint: int
    """By the number of its child link."""
    peak_torque: float
    """Of each of its servos [N·m]."""
    rms_torque: float
    """Of each of its servos, over the run [N·m]."""
    peak_speed: float
    """The greater of what the simulated joint reached and what its controller commanded [rad/s]."""
    use: float
    """The largest share of the torque–speed line that was asked for at once: above 1 the servo can't follow."""
    stall_share: float
    """Of the stall torque, on average (root mean square)."""
    saturated: float
    """Share of the steps in which the simulated motor was at the limit of its torque, and gave less than was asked."""

    @property
    def margin(self) -> float:
        """How many times stronger the servo is than it must be, at the worst instant; below 1 it can't follow."""
        return 1.0 / self.use if self.use > 0 else float("inf")


def line_use(torque: Floats, speed: Floats, servo: Servo) -> Floats:
    """Give the share of a servo's straight torque–speed line that is used.

    A motor that drives loses torque with speed; one that is driven (torque against the motion) does not, so that
    braking costs its torque alone. The speed itself must be within the no-load speed in either case.

    Args:
        torque: (...) [N·m].
        speed: (...) [rad/s], positive in the same sense.
        servo: whose line it is.
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
    commanded_speed: tuple[float, ...],
) -> list[JointLoad]:
    """Put what the simulation's motors gave on the bench's scale, beside what the servos can give.

    Args:
        joints: numbers of the driven joints.
        torque: (n_steps, n_joints) that the simulated motors gave [N·m of simulation].
        speed: (n_steps, n_joints) of the joints [rad/s of simulation].
        scales: bench for simulation.
        servo: at every joint.
        servos_per_joint: that share its torque.
        max_motor_torque: of the simulated motors [N·m of simulation].
        commanded_speed: greatest that each joint's controller asks for, amplitude · 2π f [rad/s of simulation]. The
            servo follows its timeline; the simulated joint may lag behind its own.
    """
    commanded = np.asarray(commanded_speed) * scales.frequency
    asked = torque.astype(np.float64) * scales.torque / servos_per_joint
    turning = speed.astype(np.float64) * scales.frequency
    used = line_use(asked, turning, servo)
    rms = np.sqrt(np.mean(asked**2, axis=0))
    at_limit = np.mean(np.abs(torque) >= SATURATED * max_motor_torque, axis=0)
    return [
        JointLoad(
            joint=joint,
            peak_torque=float(np.abs(asked[:, column]).max()),
            rms_torque=float(rms[column]),
            peak_speed=max(float(np.abs(turning[:, column]).max()), float(commanded[column])),
            use=max(float(used[:, column].max()), float(commanded[column]) / servo.no_load_speed_rad_s),
            stall_share=float(rms[column] / servo.stall_torque_nm),
            saturated=float(at_limit[column]),
        )
        for column, joint in enumerate(joints)
    ]
