"""The ensemble of trained members as a medium. Paper, "Simulation Environments".

The standardisation is folded into the first and last layers, and only the outputs that act remain. So
each member is a chain of rows @ weight + bias and ReLU in SI units.

A row's result must not depend on the other rows, or a trial would depend on how its designs were batched: see
tasks/simulation/networks/inference.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numba
import numpy as np
import scipy

from tasks.arrays import Float32
from tasks.residual.forms import Form, form_named, observe, velocity_changes
from tasks.simulation.networks.inference import PackedNetworks
from tasks.world import LinkStates, Physics, VelocityChange

_SCALES = ("observation_mean", "observation_deviation", "residual_mean", "residual_deviation")  # standardisation


@dataclass(frozen=True, eq=False, repr=False)
class Ensemble:
    """Networks of one shape; the first axis of every array is the member."""

    weights: tuple[Float32, ...]  # (n_members, n_in, n_out) for each layer, from a form's inputs to its outputs
    biases: tuple[Float32, ...]  # (n_members, n_out) for each layer
    form: Form
    time_step: float = field(default=Physics().time_step, kw_only=True)  # that they learned of [s]

    @staticmethod
    def from_members(members: Sequence[Mapping[str, Float32]]) -> Ensemble:
        """Stack members, at least one and all of one shape, each the arrays of :meth:`TrainedMember.arrays`."""
        by_layer = list(zip(*(_folded(member) for member in members), strict=True))
        return Ensemble(
            weights=tuple(np.stack([weight for weight, _ in layer]) for layer in by_layer),
            biases=tuple(np.stack([bias for _, bias in layer]) for layer in by_layer),
            form=_form(members[0]),
            time_step=float(members[0].get("time_step", [Physics().time_step])[0]),
        )

    def __repr__(self) -> str:
        layers = " → ".join(map(str, (self.weights[0].shape[1], *(bias.shape[1] for bias in self.biases))))
        return f"Ensemble({self.n_members} {self.form.name} networks of {layers} units)"

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
        weights, biases = ([one[None] for one in of] for of in (weights, biases))
        return Ensemble(tuple(weights), tuple(biases), self.form, time_step=self.time_step)

    def at_time_step(self, time_step: float) -> Ensemble:
        """Return the ensemble for time steps of another length [s].

        Outputs, and so changes, are in proportion, which is right to first order: drag that acted over a longer step is
        a little too weak in shorter ones.
        """
        if time_step == self.time_step:
            return self
        in_proportion = (
            *(name not in self.form.shares for name in self.form.outputs),
            *self.form.factors_in_proportion,
        )
        scale = np.where(in_proportion, time_step / self.time_step, 1.0).astype(np.float32)
        weights, biases = ((*of[:-1], of[-1] * scale) for of in (self.weights, self.biases))
        return replace(self, weights=weights, biases=biases, time_step=time_step)

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:  # noqa: ARG002 (see below)
        """Predict the velocity changes of one step; member k of several predicts entry k of the first axis.

        The step is as long as they are for (:meth:`at_time_step`). A state that is not finite gives a change that is
        not finite.
        """
        shape = links.y.shape
        if self.n_members > 1 and shape[:1] != (self.n_members,):
            raise ValueError(f"links of shape {shape}, expected ({self.n_members} members, ...)")
        inputs = observe(self.form, links).reshape(self.n_members, -1, self.weights[0].shape[1])
        change = velocity_changes(self.form, self.predict(inputs), inputs)
        vx, vy, omega = np.moveaxis(change.astype(links.y.dtype, copy=False), -1, 0)
        return VelocityChange(vx=vx.reshape(shape), vy=vy.reshape(shape), omega=omega.reshape(shape))

    def predict(self, observation: Float32) -> Float32:
        """Map (n_members, n_rows, n_inputs) inputs to (n_members, n_rows, n_outputs) outputs of the form."""
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
        form = self.form
        return PackedNetworks(self.weights, self.biases, form.read, form.act, form.reads_kicks)


def _folded(member: Mapping[str, Float32]) -> list[tuple[Float32, Float32]]:
    """Fold a member's standardisation into its first and last layers; compute in float64."""
    n_layers = sum(name.startswith("weight_") for name in member)
    form = _form(member)
    applied = slice(len(form.beside), None)
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

    # The factors of a law are outputs that depend on nothing, and what only it reads are inputs without effect.
    factors, n_unseen = member.get("factors", np.empty(0)), len(form.unseen)
    weights[0] = np.pad(weights[0], ((0, n_unseen), (0, 0)))
    weights[-1], biases[-1] = np.pad(weights[-1], ((0, 0), (0, len(factors)))), np.concatenate((biases[-1], factors))
    return [(weight.astype(np.float32), bias.astype(np.float32)) for weight, bias in zip(weights, biases, strict=True)]


def _form(member: Mapping[str, Float32]) -> Form:
    return form_named(bytes(member["form"]).decode())
