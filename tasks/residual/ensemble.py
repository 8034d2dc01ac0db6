"""The ensemble of trained members as a medium. Paper, "Simulation Environments".

The standardisation is folded into the first and last layers, and only the three velocity residuals remain, because only
they are applied. So each member is a chain of rows @ weight + bias and ReLU in SI units.

A row's result must not depend on the other rows, or a trial would depend on how its designs were batched: see
tasks/simulation/networks/inference.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np
import scipy

from tasks.arrays import Float32
from tasks.residual.observation import INPUTS, NUMBERED, OBSERVATION, STATE, VELOCITIES, observe
from tasks.residual.wetted import WETTED, in_world_axes
from tasks.simulation.networks.inference import PackedNetworks
from tasks.simulation.networks.wetted import WETTED_FIELDS
from tasks.world import LinkStates, Physics, VelocityChange

N_OUT = len(STATE[VELOCITIES])
_SCALES = ("observation_mean", "observation_deviation", "residual_mean", "residual_deviation")  # standardisation


@dataclass(frozen=True, eq=False, repr=False)
class Ensemble:
    """Networks of one shape; the first axis of every array is the member."""

    weights: tuple[Float32, ...]  # (n_members, n_in, n_out) for each layer, from observations to 3 changes or 4 outputs
    biases: tuple[Float32, ...]  # (n_members, n_out) for each layer
    inputs: tuple[str, ...] = OBSERVATION  # any of INPUTS, or WETTED

    @staticmethod
    def from_members(members: Sequence[Mapping[str, Float32]]) -> Ensemble:
        """Stack members, at least one and all of one shape, each the arrays of :meth:`TrainedMember.arrays`."""
        by_layer = list(zip(*(_folded(member) for member in members), strict=True))
        return Ensemble(
            weights=tuple(np.stack([weight for weight, _ in layer]) for layer in by_layer),
            biases=tuple(np.stack([bias for _, bias in layer]) for layer in by_layer),
            inputs=_inputs(members[0]),
        )

    def __repr__(self) -> str:
        layers = " → ".join(map(str, (len(self.inputs), *(bias.shape[1] for bias in self.biases))))
        return f"Ensemble({self.n_members} networks of {layers} units, inputs {', '.join(self.inputs)})"

    @property
    def n_members(self) -> int:
        """Number of networks."""
        return len(self.weights[0])

    def mean(self) -> Ensemble:
        """Return one network that has the members' side by side, whose output is their mean."""
        n_in, n_out = self.weights[0].shape[1], self.weights[-1].shape[2]
        weights = [scipy.linalg.block_diag(*weight).astype(np.float32) for weight in self.weights]
        weights[0] = self.weights[0].swapaxes(0, 1).reshape(n_in, -1)
        weights[-1] = self.weights[-1].reshape(-1, n_out) / np.float32(self.n_members)
        biases = [*(bias.reshape(-1) for bias in self.biases[:-1]), self.biases[-1].mean(axis=0)]
        return Ensemble(tuple(one[None] for one in weights), tuple(one[None] for one in biases), self.inputs)

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:  # noqa: ARG002 (see below)
        """Predict the velocity changes of one step; member k predicts entry k of the first axis.

        The length of the step is implied by the throws. A state that is not finite gives a change that is not finite.

        Raises:
            ValueError: the links' first axis is not n_members long.
        """
        shape = links.y.shape
        if not shape or shape[0] != self.n_members:
            raise ValueError(f"links of shape {shape}, expected ({self.n_members} members, ...)")
        observation = observe(vars(links), self.inputs)
        change = self.predict(observation.reshape(self.n_members, -1, len(self.inputs)))
        if self.inputs == WETTED:
            change = in_world_axes(observation.reshape(*change.shape[:-1], -1), change)
        vx, vy, omega = np.moveaxis(change.astype(links.y.dtype, copy=False), -1, 0)
        return VelocityChange(vx=vx.reshape(shape), vy=vy.reshape(shape), omega=omega.reshape(shape))

    def predict(self, observation: Float32) -> Float32:
        """Map (n_members, n_rows, n_inputs) observations to (n_members, n_rows, n_outputs) outputs.

        They are changes of vx, vy, ω in a step, or the 4 of :mod:`tasks.residual.wetted`.
        """
        return self.networks.forward(observation) if self.networks else self._predicted_by_numpy(observation)

    def _predicted_by_numpy(self, rows: Float32) -> Float32:
        *hidden_layers, (last_weight, last_bias) = zip(self.weights, self.biases, strict=True)
        for weight, bias in hidden_layers:
            rows = (rows @ weight + bias[:, None]).clip(0)
        return rows @ last_weight + last_bias[:, None]

    @cached_property
    def networks(self) -> PackedNetworks | None:
        """Networks of the compiled kernel; None without the compiler, where the kernel would take minutes."""
        if numba.config.DISABLE_JIT:
            return None
        if self.inputs == WETTED:
            return PackedNetworks(self.weights, self.biases, WETTED_FIELDS, wetted=True)
        return PackedNetworks(self.weights, self.biases, tuple(INPUTS[name] for name in self.inputs))


def _folded(member: Mapping[str, Float32]) -> list[tuple[Float32, Float32]]:
    """Fold a member's standardisation into its first and last layers; compute in float64."""
    n_layers = sum(name.startswith("weight_") for name in member)
    applied = slice(None) if _inputs(member) == WETTED else VELOCITIES
    weights, biases = (
        [member[f"{kind}_{i}"].astype(np.float64) for i in range(n_layers)] for kind in ("weight", "bias")
    )

    # W ((o - mean) / deviation) + b = (W / deviation) o + (b - W mean / deviation)
    observation_mean, observation_deviation, residual_mean, residual_deviation = (
        member[name].astype(np.float64) for name in _SCALES
    )
    weights[0] = weights[0] / observation_deviation[:, None]
    biases[0] = biases[0] - (observation_mean[:, None] * weights[0]).sum(axis=0)  # in the same order everywhere
    weights[-1] = (weights[-1] * residual_deviation)[:, applied]
    biases[-1] = (biases[-1] * residual_deviation + residual_mean)[applied]
    return [(weight.astype(np.float32), bias.astype(np.float32)) for weight, bias in zip(weights, biases, strict=True)]


def _inputs(member: Mapping[str, Float32]) -> tuple[str, ...]:
    """Return what a member observes: its array of numbers in the table of inputs, or the paper's six."""
    if "inputs" not in member:
        return OBSERVATION
    return tuple(NUMBERED[int(number)] for number in member["inputs"])
