"""An ensemble whose networks something else than the batch engine evaluates, in each step."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

from tasks.arrays import Float32
from tasks.residual.ensemble import Ensemble

Layers = Sequence[tuple[Float32, Float32]]
"""(n_members, n_in, n_out) weights and (n_members, n_out) biases of each layer."""
Predict = Callable[[Float32], Float32]
"""Maps (n_members, n_rows, n_inputs) inputs to (n_members, n_rows, n_outputs) outputs."""

TOLERANCE = 1e-5
"""Greatest error of outputs by rounding, relative to the largest output: that of float32, which TF32 exceeds."""


@dataclass(frozen=True, eq=False, repr=False)
class ServedEnsemble(Ensemble):
    """An ensemble that reads links and acts on them as any other. ``connect`` returns what evaluates its networks."""

    connect: Callable[["ServedEnsemble", int], Predict]  # by the ensemble and the number of rows of each member

    def predict(self, observation: Float32) -> Float32:
        """Map (n_members, n_rows, n_inputs) inputs to (n_members, n_rows, n_outputs) outputs of the form."""
        return self.connect(self, observation.shape[1])(observation)

    @property
    def networks(self) -> None:
        """None: the engine's kernels have none to call."""

    @property
    def layers(self) -> Layers:
        """Weights and biases of each layer."""
        return list(zip(self.weights, self.biases, strict=True))

    @cached_property
    def key(self) -> bytes:
        """Digest of the networks."""
        return hashlib.sha256(b"".join(array.tobytes() for array in (*self.weights, *self.biases))).digest()
