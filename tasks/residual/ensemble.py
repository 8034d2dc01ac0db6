"""The ensemble of trained members as a medium. Paper, "Simulation Environments".

The standardisation is folded into the first and last layers, and only the three velocity residuals remain, because only
they are applied. So each member is a chain of rows @ weight + bias and ReLU in SI units.

A row's result must not depend on the other rows, or a trial would depend on how its designs were batched. On a CPU that
holds by construction: see tasks/simulation/networks/inference.py. torch chooses the algorithm of a matrix product by
its shape, so the last bits change with the number of rows; on CUDA, results are equal only for batches of equal size.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np
import torch
from torch import Tensor

from tasks.arrays import Float32
from tasks.residual.observation import INPUTS, NUMBERED, OBSERVATION, STATE, VELOCITIES, observe
from tasks.residual.wetted import N_WETTED_OUTPUTS, WETTED, in_world_axes
from tasks.simulation.networks.coupled import WETTED_FIELDS
from tasks.simulation.networks.inference import PackedNetworks
from tasks.world import LinkStates, Physics, VelocityChange

N_OUT = len(STATE[VELOCITIES])
_SCALES = ("observation_mean", "observation_deviation", "residual_mean", "residual_deviation")  # standardisation


class WeightsError(ValueError):
    """Arrays that are not those of an ensemble or member."""


@dataclass(frozen=True, eq=False)
class Ensemble:
    """Networks of one shape; the first axis of every array is the member."""

    weights: tuple[Float32, ...]  # (n_members, n_in, n_out) for each layer, from observations to 3 changes or 4 outputs
    biases: tuple[Float32, ...]  # (n_members, n_out) for each layer
    inputs: tuple[str, ...] = OBSERVATION  # any of INPUTS, or WETTED
    device: str = "cpu"  # device of the networks: "cpu" selects the compiled kernel, any other name is torch's

    def __post_init__(self) -> None:
        n_members = self.weights[0].shape[:1]
        if n_members == (0,):
            raise WeightsError("an ensemble of 0 members, expected at least 1")
        n_out = N_OUT + (self.inputs == WETTED)
        _check_layers(self.weights, self.biases, n_in=len(self.inputs), n_out=n_out, members=n_members)

    @staticmethod
    def from_members(members: Sequence[Mapping[str, Float32]], *, device: str = "cpu") -> Ensemble:
        """Stack members, each given by the arrays of :meth:`TrainedMember.arrays`.

        Raises:
            WeightsError: there are no members; an array is missing, of the wrong shape or not finite; or shapes differ.
        """
        if not members:
            raise WeightsError("an ensemble of 0 members, expected at least 1")
        folded = [_folded(member, k) for k, member in enumerate(members)]
        shapes = [[weight.shape for weight, _ in layers] for layers in folded]
        for k, shape in enumerate(shapes):
            if shape != shapes[0]:
                raise WeightsError(f"member {k} has layers {shape}, expected those of member 0: {shapes[0]}")
        inputs = [_inputs(member, f"member {k}") for k, member in enumerate(members)]
        if len(set(inputs)) > 1:
            raise WeightsError(f"members observe {' and '.join(map(str, dict.fromkeys(inputs)))}, expected the same")
        by_layer = list(zip(*folded, strict=True))
        return Ensemble(
            weights=tuple(np.stack([weight for weight, _ in layer]) for layer in by_layer),
            biases=tuple(np.stack([bias for _, bias in layer]) for layer in by_layer),
            inputs=inputs[0],
            device=device,
        )

    @property
    def n_members(self) -> int:
        """Number of networks."""
        return len(self.weights[0])

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
        if self.networks is not None:
            return self.networks.forward(observation)
        return self.predict_with_torch(observation)

    def predict_with_torch(self, observation: Float32) -> Float32:
        """Predict with torch on the device: for CUDA, and for comparison with the compiled kernel."""
        with torch.inference_mode():
            torch.set_num_threads(1)  # the number of threads changes the last bits
            return self._forward(torch.from_numpy(observation).to(self.device)).cpu().numpy()

    def _forward(self, rows: Tensor) -> Tensor:
        *hidden_layers, (last_weight, last_bias) = self._tensors
        for weight, bias in hidden_layers:
            rows = torch.baddbmm(bias, rows, weight).relu_()
        return torch.baddbmm(last_bias, rows, last_weight)

    @cached_property
    def networks(self) -> PackedNetworks | None:
        """Networks of the compiled kernel; None where torch is used instead."""
        if self.device != "cpu" or numba.config.DISABLE_JIT:
            return None
        if self.inputs == WETTED:
            return PackedNetworks(self.weights, self.biases, WETTED_FIELDS, wetted=True)
        return PackedNetworks(self.weights, self.biases, tuple(INPUTS[name] for name in self.inputs))

    @cached_property
    def _tensors(self) -> tuple[tuple[Tensor, Tensor], ...]:
        """Weights and (n_members, 1, n_out) biases in memory that torch aligns."""
        return tuple(
            (torch.tensor(weight, device=self.device), torch.tensor(bias[:, None], device=self.device))
            for weight, bias in zip(self.weights, self.biases, strict=True)
        )


def _folded(member: Mapping[str, Float32], k: int) -> list[tuple[Float32, Float32]]:
    """Fold a member's standardisation into its first and last layers; compute in float64."""
    whose = f"member {k}"
    n_layers = _count_layers(member, whose)
    inputs = _inputs(member, whose)
    n_in, n_out, applied = len(inputs), len(STATE), VELOCITIES
    if inputs == WETTED:
        n_out, applied = N_WETTED_OUTPUTS, slice(None)
    for name in _SCALES:
        _check(f"{whose}: {name}", member[name], (n_in if name.startswith("observation") else n_out,))
    layers = [member[f"weight_{i}"] for i in range(n_layers)], [member[f"bias_{i}"] for i in range(n_layers)]
    _check_layers(*layers, n_in=n_in, n_out=n_out, whose=f"{whose}: ")
    weights, biases = ([array.astype(np.float64) for array in arrays] for arrays in layers)

    # W ((o - mean) / deviation) + b = (W / deviation) o + (b - W mean / deviation)
    observation_mean, observation_deviation, residual_mean, residual_deviation = (
        member[name].astype(np.float64) for name in _SCALES
    )
    weights[0] = weights[0] / observation_deviation[:, None]
    biases[0] = biases[0] - (observation_mean[:, None] * weights[0]).sum(axis=0)  # in the same order everywhere
    weights[-1] = (weights[-1] * residual_deviation)[:, applied]
    biases[-1] = (biases[-1] * residual_deviation + residual_mean)[applied]
    return [(weight.astype(np.float32), bias.astype(np.float32)) for weight, bias in zip(weights, biases, strict=True)]


def _inputs(member: Mapping[str, Float32], whose: str) -> tuple[str, ...]:
    """Return what a member observes: its array of numbers in the table of inputs, or the paper's six."""
    if "inputs" not in member:
        return OBSERVATION
    numbers = np.asarray(member["inputs"])
    if numbers.ndim != 1 or not np.isin(numbers, np.arange(len(NUMBERED))).all():
        raise WeightsError(f"{whose}: inputs is {numbers.tolist()}, expected numbers from 0 to {len(NUMBERED) - 1}")
    return tuple(NUMBERED[int(number)] for number in numbers)


def _count_layers(arrays: Mapping[str, Float32], whose: str) -> int:
    """Count a member's layers, at least two; refuse missing and unknown names."""
    n_layers = max(sum(name.startswith("weight_") for name in arrays), 2)
    expected = {f"{kind}_{i}" for kind in ("weight", "bias") for i in range(n_layers)} | set(_SCALES)
    if set(arrays) - {"inputs"} != expected:
        missing, unknown = sorted(expected - set(arrays)), sorted(set(arrays) - expected)
        raise WeightsError(f"{whose}: arrays are missing {missing} and unknown {unknown}, expected {sorted(expected)}")
    return n_layers


def _check_layers(
    weights: Sequence[Float32],
    biases: Sequence[Float32],
    *,
    n_in: int,
    n_out: int,
    members: tuple[int, ...] = (),
    whose: str = "",
) -> None:
    """Refuse layers that do not connect n_in observations to n_out residuals."""
    for i, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        last = i == len(weights) - 1
        n_units = n_out if last or weight.ndim == 0 else weight.shape[-1]
        _check(f"{whose}weight_{i}", weight, (*members, n_in, n_units))
        _check(f"{whose}bias_{i}", bias, (*members, n_units))
        n_in = n_units


def _check(name: str, array: Float32, shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise WeightsError(f"{name} has shape {array.shape}, expected {shape}")
    if array.dtype != np.float32:
        raise WeightsError(f"{name} is of {array.dtype}, expected float32")
    if not np.isfinite(array).all():
        raise WeightsError(f"{name} has values that are not finite")
