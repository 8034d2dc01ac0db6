"""Networks on one core: the kernel compared with torch and with the core's peak."""

# ruff: noqa: ARG001 (numba gives every intrinsic its context)

from __future__ import annotations

from functools import partial
from itertools import pairwise
from typing import Any

import numba
import numpy as np
import torch
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from benchmarks.engines import N_ROUNDS, designs
from benchmarks.measure import Benchmark, seconds
from tasks.arrays import Float32
from tasks.residual import Architecture, Form, Training
from tasks.residual.descent import Descent
from tasks.residual.ensemble import Ensemble
from tasks.residual.forms import Targets
from tasks.residual.forms.plain import PLAIN
from tasks.residual.forms.wetted import WETTED
from tasks.residual.network import initial_weights
from tasks.residual.torch_descent import TorchDescent
from tasks.simulation import simulate
from tasks.simulation.networks.tiles import N_LANES
from tasks.world import ResidualSlush

N_MEMBERS = 8
SHAPES = ((2, 32), (2, 64), (3, 128), (4, 256))
N_CHAINS = 24 if N_LANES == 16 else 12


@intrinsic
def _multiply_add(typing: Any, n: Any) -> Any:
    """Run independent chains of multiply-adds in registers, the most that the core can do."""

    def emit(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        vector = ir.VectorType(ir.FloatType(), N_LANES)
        fma = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(vector, [vector] * 3), f"llvm.fma.v{N_LANES}f32"
        )
        before, loop, after = builder.block, builder.append_basic_block(), builder.append_basic_block()
        builder.branch(loop)
        builder.position_at_end(loop)
        i, chains = builder.phi(args[0].type), [builder.phi(vector) for _ in range(N_CHAINS)]
        factor, term = (ir.Constant(vector, [x] * N_LANES) for x in (0.999, 1e-3))
        grown = [builder.call(fma, [chain, factor, term]) for chain in chains]
        following = builder.add(i, ir.Constant(i.type, 1))
        i.add_incoming(ir.Constant(i.type, 0), before)
        i.add_incoming(following, loop)
        for k, (chain, value) in enumerate(zip(chains, grown, strict=True)):
            chain.add_incoming(ir.Constant(vector, [float(k)] * N_LANES), before)
            chain.add_incoming(value, loop)
        builder.cbranch(builder.icmp_signed("<", following, args[0]), loop, after)
        builder.position_at_end(after)
        total = grown[0]
        for value in grown[1:]:
            total = builder.fadd(total, value)
        return builder.extract_element(total, ir.Constant(ir.IntType(32), 0))

    return types.float32(types.intp), emit


@numba.njit
def _peak(n: int) -> float:
    return _multiply_add(n)


def peak_gflops() -> float:
    """Measure the core's peak in float32 [GFLOP/s]."""
    n = 300_000
    return 2 * N_CHAINS * N_LANES * n / seconds(lambda: _peak(n)) / 1e9


def ensemble(hidden_layers: int, width: int, n_members: int = N_MEMBERS, form: Form = PLAIN) -> Ensemble:
    """Create untrained networks of a shape, whose outputs are too small to move a robot."""
    rng = np.random.default_rng(1)
    sizes = (len(form.inputs), *[width] * hidden_layers, len(form.outputs))
    weights = [(rng.normal(size=(n_members, a, b)) / np.sqrt(a)).astype(np.float32) for a, b in pairwise(sizes)]
    weights[-1] *= np.float32(0.01)
    return Ensemble(tuple(weights), tuple(np.zeros((n_members, b), np.float32) for b in sizes[1:]), form)


def by_torch(nets: Ensemble, observation: Float32) -> Float32:
    """Evaluate an ensemble as torch's user would."""
    with torch.inference_mode():
        rows = torch.from_numpy(observation)
        *hidden_layers, (last_weight, last_bias) = [
            (torch.from_numpy(weight), torch.from_numpy(bias[:, None]))
            for weight, bias in zip(nets.weights, nets.biases, strict=True)
        ]
        for weight, bias in hidden_layers:
            rows = torch.baddbmm(bias, rows, weight).relu_()
        return torch.baddbmm(last_bias, rows, last_weight).numpy()


def inference() -> list[Benchmark]:
    """Evaluate 8 members on 384 samples each: the kernel, torch's bmm, the core's peak."""
    _peak(10)
    figures = []
    torch.set_num_threads(1)
    rows = np.random.default_rng(2).normal(size=(N_MEMBERS, 384, 6)).astype(np.float32)
    for hidden_layers, width in SHAPES:
        nets = ensemble(hidden_layers, width)
        flop = 2 * rows.shape[0] * rows.shape[1] * sum(a * b for a, b in pairwise((6, *[width] * hidden_layers, 3)))
        shares, ratios = [], []
        for _ in range(N_ROUNDS):
            peak = max(peak_gflops() for _ in range(5))
            ours, theirs = (
                min(seconds(lambda run=run: run(rows)) for _ in range(8))
                for run in (nets.predict, partial(by_torch, nets))
            )
            shares.append(100 * flop / ours / 1e9 / peak)
            ratios.append(theirs / ours)
        shape = f"{hidden_layers} × {width}"
        figures += [
            Benchmark(f"networks {shape} of the fp32 peak", shares, "%", 70.0 if width == 256 else None, at_least=True),
            Benchmark(
                f"networks {shape} over torch", ratios, "times", 1.3 if width in (64, 128) else None, at_least=True
            ),
        ]
    return [Benchmark("fp32 peak of the core", [peak_gflops() for _ in range(N_ROUNDS)], "GFLOP/s"), *figures]


def wetted() -> list[Benchmark]:
    """Evaluate a generation in networks that know what is under water, and in plain ones of the same size."""
    plain, wet = (ResidualSlush(2.0, ensemble(2, 48, 4, form)) for form in (PLAIN, WETTED))
    for environment in (plain, wet):
        simulate(designs(), environment, n_settle=1, n_measure=1)
    ratios = []
    for _ in range(N_ROUNDS):
        theirs, ours = (
            min(seconds(lambda e=environment: simulate(designs(), e, n_settle=20, n_measure=120)) for _ in range(5))
            for environment in (plain, wet)
        )
        ratios.append(ours / theirs)
    return [Benchmark("a generation in wetted networks, 4 of 2 × 48, over plain ones", ratios, "times", 1.3)]


def training() -> list[Benchmark]:
    """Train networks of three shapes for some iterations: the kernel and torch."""
    figures = []
    for (hidden_layers, width), batch_size in (((2, 32), 2048), ((3, 64), 4096), ((4, 256), 16384)):
        rng = np.random.default_rng(3)
        architecture = Architecture(hidden_layers=hidden_layers, width=width)
        settings = Training(loss="mse", batch_size=batch_size)
        inputs, values = rng.normal(size=(2, 90_000, 6)).astype(np.float32)
        targets = Targets(values, values[:, :0], values[:, :0])
        weights = initial_weights(architecture.sizes, rng)
        rng = np.random.default_rng(4)
        ours = Descent(weights, inputs, targets, architecture.dropout, settings, rng)
        theirs = TorchDescent([weights], [(inputs, targets)], architecture.dropout, settings, [rng])
        n = max(1, 400_000 // (batch_size * width))
        ours.advance(1)
        theirs.advance(1)
        times, ratios = [], []
        for _ in range(N_ROUNDS):
            by_kernel, by_torch = (
                min(seconds(lambda run=run, n=n: run.advance(n)) for _ in range(4)) / n for run in (ours, theirs)
            )
            times.append(1e3 * by_kernel)
            ratios.append(by_torch / by_kernel)
        shape = f"{hidden_layers} × {width}"
        figures += [
            Benchmark(f"a training iteration of {batch_size:,} samples, {shape}", times, "ms"),
            Benchmark(f"training {shape} over torch", ratios, "times"),
        ]
    return figures
