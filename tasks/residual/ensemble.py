"""The ensemble: trained members side by side, as a medium. Paper, "Simulation Environments".

The standardisation is folded into the first and last layers, and only the three velocity residuals are kept, because
only they are applied. What is left is rows @ weight + bias and ReLU, per member, in SI units.

A row's result must not depend on the rows beside it, or a trial would depend on how its designs were batched. On a CPU
that is so by construction: see tasks/simulation/networks/inference.py. torch's matrix product picks its algorithm by shape and so
changes in its last bits with the number of rows; on CUDA the promise holds for batches of one size alone.
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
from tasks.residual.observation import OBSERVATION, OBSERVED, STATE, VELOCITIES, observe
from tasks.simulation.networks.inference import PackedNetworks
from tasks.world import LinkStates, Physics, VelocityChange

N_OUT = len(STATE[VELOCITIES])
SCALES = ("observation_mean", "observation_deviation", "residual_mean", "residual_deviation")
"""A member's standardisation."""


class WeightsError(ValueError):
    """Arrays that are not an ensemble's or a member's: names the array, what was expected and what came."""


@dataclass(frozen=True, eq=False)
class Ensemble:
    """Networks of one shape, one member per entry of the arrays' first axis."""

    weights: tuple[Float32, ...]
    """Of layer i: (n_members, n_in, n_out), from 6 observations to 3 velocity changes."""
    biases: tuple[Float32, ...]
    """Of layer i: (n_members, n_out)."""
    device: str = "cpu"
    """Where the networks run: "cpu" is our own kernel, any other is torch's name for a device."""

    def __post_init__(self) -> None:
        n_members = self.weights[0].shape[:1]
        if n_members == (0,):
            raise WeightsError("an ensemble of no members, expected at least one")
        _check_layers(self.weights, self.biases, n_out=N_OUT, members=n_members)

    @staticmethod
    def from_members(members: Sequence[Mapping[str, Float32]], *, device: str = "cpu") -> Ensemble:
        """Stack members, each as :meth:`TrainedMember.arrays` gives them.

        Raises:
            WeightsError: an array is missing, of the wrong shape or not finite, or members differ in shape.
        """
        if not members:
            raise WeightsError("an ensemble of no members, expected at least one")
        folded = [_folded(member, k) for k, member in enumerate(members)]
        shapes = [[weight.shape for weight, _ in layers] for layers in folded]
        for k, shape in enumerate(shapes):
            if shape != shapes[0]:
                raise WeightsError(f"member {k} has layers {shape}, expected those of member 0: {shapes[0]}")
        by_layer = list(zip(*folded, strict=True))
        return Ensemble(
            weights=tuple(np.stack([weight for weight, _ in layer]) for layer in by_layer),
            biases=tuple(np.stack([bias for _, bias in layer]) for layer in by_layer),
            device=device,
        )

    @property
    def n_members(self) -> int:
        """How many networks there are."""
        return len(self.weights[0])

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:  # noqa: ARG002 (see below)
        """Predict what the slush adds to velocities in one step: entry k of the first axis by member k.

        The length of the step is in the weights, from the throws. States that are not finite give changes that are
        not finite, in their own rows.

        Raises:
            ValueError: the links' first axis is not n_members long.
        """
        shape = links.y.shape
        if not shape or shape[0] != self.n_members:
            raise ValueError(f"links of shape {shape}, expected ({self.n_members} members, ...)")
        observation = observe(**{name: getattr(links, name) for name in OBSERVED})
        change = self.predict(observation.reshape(self.n_members, -1, len(OBSERVATION)))
        vx, vy, omega = np.moveaxis(change.astype(links.y.dtype, copy=False), -1, 0)
        return VelocityChange(vx=vx.reshape(shape), vy=vy.reshape(shape), omega=omega.reshape(shape))

    def predict(self, observation: Float32) -> Float32:
        """Map (n_members, n_rows, 6) observations to (n_members, n_rows, 3) changes of vx, vy, ω a step, in SI."""
        if self.networks is not None:
            return self.networks.forward(observation)
        return self.predict_with_torch(observation)

    def predict_with_torch(self, observation: Float32) -> Float32:
        """Map like :meth:`predict`, by torch on the device: for CUDA, and to compare."""
        with torch.inference_mode():
            torch.set_num_threads(1)  # the number of threads changes the last bits
            return self._forward(torch.from_numpy(observation).to(self.device)).cpu().numpy()

    def _forward(self, rows: Tensor) -> Tensor:
        """(n_members, n_rows, 6) to (n_members, n_rows, 3)."""
        *hidden_layers, (last_weight, last_bias) = self._tensors
        for weight, bias in hidden_layers:
            rows = torch.baddbmm(bias, rows, weight).relu_()
        return torch.baddbmm(last_bias, rows, last_weight)

    @cached_property
    def networks(self) -> PackedNetworks | None:
        """What the batch engine's own kernel runs; None where torch does the work."""
        if self.device != "cpu" or numba.config.DISABLE_JIT:
            return None
        return PackedNetworks(self.weights, self.biases, OBSERVED)

    @cached_property
    def _tensors(self) -> tuple[tuple[Tensor, Tensor], ...]:
        """Weights and (n_members, 1, n_out) biases in torch's own memory, whose alignment it chooses."""
        return tuple(
            (torch.tensor(weight, device=self.device), torch.tensor(bias[:, None], device=self.device))
            for weight, bias in zip(self.weights, self.biases, strict=True)
        )


def _folded(member: Mapping[str, Float32], k: int) -> list[tuple[Float32, Float32]]:
    """Fold a member's standardisation into its first and last layers and keep the velocities, in float64."""
    whose = f"member {k}"
    n_layers = _count_layers(member, whose)
    for name in SCALES:
        _check(f"{whose}: {name}", member[name], (len(STATE),))
    layers = [member[f"weight_{i}"] for i in range(n_layers)], [member[f"bias_{i}"] for i in range(n_layers)]
    _check_layers(*layers, n_out=len(STATE), whose=f"{whose}: ")
    weights, biases = ([array.astype(np.float64) for array in arrays] for arrays in layers)

    # W ((o - mean) / deviation) + b = (W / deviation) o + (b - W mean / deviation)
    observation_mean, observation_deviation, residual_mean, residual_deviation = (
        member[name].astype(np.float64) for name in SCALES
    )
    weights[0] = weights[0] / observation_deviation[:, None]
    biases[0] = biases[0] - observation_mean @ weights[0]
    weights[-1] = (weights[-1] * residual_deviation)[:, VELOCITIES]
    biases[-1] = (biases[-1] * residual_deviation + residual_mean)[VELOCITIES]
    return [(weight.astype(np.float32), bias.astype(np.float32)) for weight, bias in zip(weights, biases, strict=True)]


def _count_layers(arrays: Mapping[str, Float32], whose: str) -> int:
    """Count a member's layers, of which there are two or more, and refuse names that are missing or unknown."""
    n_layers = max(sum(name.startswith("weight_") for name in arrays), 2)
    expected = {f"{kind}_{i}" for kind in ("weight", "bias") for i in range(n_layers)} | set(SCALES)
    if set(arrays) != expected:
        missing, unknown = sorted(expected - set(arrays)), sorted(set(arrays) - expected)
        raise WeightsError(f"{whose}: arrays are missing {missing} and unknown {unknown}, expected {sorted(expected)}")
    return n_layers


def _check_layers(
    weights: Sequence[Float32], biases: Sequence[Float32], *, n_out: int, members: tuple[int, ...] = (), whose: str = ""
) -> None:
    """Refuse layers that do not follow each other from 6 observations to n_out residuals."""
    n_in = len(OBSERVATION)
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
