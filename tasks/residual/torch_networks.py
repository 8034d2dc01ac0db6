"""Evaluation of many networks by torch: on a GPU, or where there is none on the CPU."""

import weakref
from typing import Any

import numpy as np
import torch

from tasks.arrays import Float32, Float64
from tasks.residual.served_ensemble import TOLERANCE, Layers
from tasks.residual.torch_descent import n_cuda_devices, one_thread
from tasks.seeding import generator

_N_CHECKED = 64  # rows of each member


class OutOfTolerance(ArithmeticError):  # noqa: N818 (what is the case)
    """Outputs have more rounding errors than those of float32."""


class TorchNetworks:
    """Networks of one shape, whose inputs and outputs have their place in the caller's memory."""

    def __init__(self, layers: Layers, x: Float32, y: Float32, device: int = 0) -> None:
        """Load the networks.

        Args:
            layers: weights and biases.
            x: (n_members, n_rows, n_inputs) inputs.
            y: (n_members, n_rows, n_outputs) outputs.
            device: number of the GPU, if there is any.
        """
        self._on_gpu = n_cuda_devices() > 0
        where = torch.device("cuda", device) if self._on_gpu else torch.device("cpu")
        self._layers = [
            (torch.tensor(weight, device=where), torch.tensor(bias[:, None], device=where)) for weight, bias in layers
        ]
        self._x, self._y = torch.from_numpy(x), torch.from_numpy(y)
        if self._on_gpu:
            with torch.cuda.device(where):
                self._record(x, y)
        x[:] = generator(0, "tolerance").normal(size=x.shape)
        expected = _exactly(layers, x[:, :_N_CHECKED])
        error = float(np.abs(self(x)[:, :_N_CHECKED] - expected).max() / np.abs(expected).max())
        if not error < TOLERANCE:
            raise OutOfTolerance(f"outputs have errors of {error:.1g} of the largest, expected less than {TOLERANCE:g}")

    def __call__(self, observation: Float32) -> Float32:
        """Map inputs to outputs, both in the caller's memory."""
        self._x.copy_(torch.from_numpy(observation))
        self.start()
        while not self.done():
            pass
        return self._y.numpy()

    def _record(self, *arrays: Float32) -> None:
        """Record an evaluation as a CUDA graph, which copies inputs and outputs, too."""
        cudart: Any = torch.cuda.cudart()  # type: ignore[no-untyped-call]
        for array in arrays:  # lock them in memory, so that no copy waits
            if code := int(cudart.cudaHostRegister(array.ctypes.data, array.nbytes, 0)):
                raise RuntimeError(f"cudaHostRegister: expected 0, got {code}")
            weakref.finalize(self, cudart.cudaHostUnregister, array.ctypes.data)  # while it is still there
        self._stream: Any = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        self._event: Any = torch.cuda.Event()  # type: ignore[no-untyped-call]
        with torch.cuda.stream(self._stream):
            for _ in range(3):  # libraries set themselves up
                self._evaluate()
        self._stream.synchronize()
        self._graph = torch.cuda.CUDAGraph()
        # Another thread may ask the device meanwhile, whether it has evaluated other networks.
        with torch.cuda.graph(self._graph, stream=self._stream, capture_error_mode="thread_local"):
            self._evaluate()

    @torch.no_grad()
    def _evaluate(self) -> None:
        *hidden, (last_weight, last_bias) = self._layers
        rows = self._x.to(last_weight.device, non_blocking=True)
        for weight, bias in hidden:
            rows = torch.baddbmm(bias, rows, weight).relu_()
        self._y.copy_(torch.baddbmm(last_bias, rows, last_weight), non_blocking=True)

    def start(self) -> None:
        """Begin to compute outputs; a GPU goes on alone."""
        if self._on_gpu:
            with torch.cuda.stream(self._stream):
                self._graph.replay()
                self._event.record()
        else:
            with one_thread():
                self._evaluate()

    def done(self) -> bool:
        """Return whether the outputs are there."""
        return bool(self._event.query()) if self._on_gpu else True


def _exactly(layers: Layers, x: Float32) -> Float64:
    rows = x.astype(np.float64)
    for i, (weight, bias) in enumerate(layers):
        rows = (rows.clip(0) if i else rows) @ weight.astype(np.float64) + bias[:, None]
    return rows
