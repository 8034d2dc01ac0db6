"""Train the paper's ensembles on one GPU: eight networks of 4 x 256, minibatches of 262,144 drawn with replacement.

A minibatch is larger than the data set, so most rows are drawn several times. Each row is computed once and weighted by
the number of times it was drawn, which gives the same gradient. Factors of products are rounded to half precision,
whose mantissa is that of TF32, and summed in float32; losses are scaled. Weights, moments and updates are float32.

    python train.py --data data.npz --runs 0:50000,1:15000 --out FOLDER

DATA has, for data set k of the preset paper, x{k} (n_rows, 6) standardised observations, t{k} (n_rows, 6) standardised
residuals, and seeds (n_data_sets,). It needs torch for CUDA and triton and nothing else of this project.
"""

import argparse
import hashlib
import json
import math
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
import triton
import triton.language as tl

W = 256
PAD = 16  # columns of the padded inputs and outputs
N_OUT = 6
BETA_1, BETA_2, EPS = 0.9, 0.999, 1e-8


@triton.jit
def draw(counts, step, N, NC, B, seed, BLOCK: tl.constexpr):
    """Draw minibatches: increment the count of each drawn row."""
    m = tl.program_id(1)
    i = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    t = tl.load(step)
    r = tl.randint(seed + t, m * B + i).to(tl.uint32, bitcast=True).to(tl.uint64)
    row = ((r * N) >> 32).to(tl.int32)
    tl.atomic_add(counts + m * NC + row, 1, mask=i < B, sem="relaxed")


@triton.jit
def drop(H, step, n, n_drawn, seed, BLOCK: tl.constexpr):
    """Set units of each member that are drawn at random to zero."""
    m = tl.program_id(1)
    i = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    t = tl.load(step)
    r = tl.randint(seed + t, m * n_drawn + i).to(tl.uint32, bitcast=True).to(tl.uint64)
    unit = ((r * n) >> 32).to(tl.int64)
    tl.store(H + m.to(tl.int64) * n + unit, tl.zeros((BLOCK,), tl.float16), mask=i < n_drawn)


@triton.jit
def gather_rows(X, index, out, n, BLOCK: tl.constexpr, PADDED: tl.constexpr):
    """Copy the listed rows."""
    i = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    pad = tl.arange(0, PADDED)
    row = tl.load(index + i, mask=i < n, other=0)
    x = tl.load(X + row[:, None] * PADDED + pad[None, :])
    tl.store(out + i[:, None] * PADDED + pad[None, :], x, mask=(i < n)[:, None])


@triton.jit
def output(
    T,
    index,
    counts,
    Y,
    GY,
    H,
    G,
    W4T,
    B4,
    PB,
    PB4,
    loss,
    largest,
    step,
    every,
    scale_in,
    N,
    NC,
    NP,
    GROUPS,
    B,
    alpha,
    s,
    focal: tl.constexpr,
    BM: tl.constexpr,
    REPEAT: tl.constexpr,
    WIDTH: tl.constexpr,
    PADDED: tl.constexpr,
):
    """Compute the loss, and its gradients at the output and the last hidden layer, for tiles of a member's rows."""
    group, m = tl.program_id(0), tl.program_id(1)
    t = tl.load(step)
    cols = tl.arange(0, WIDTH)
    pad = tl.arange(0, PADDED)
    own = m.to(tl.int64) * NP * WIDTH
    scale = tl.load(scale_in)
    w4t = tl.load(W4T + m * PADDED * WIDTH + pad[:, None] * WIDTH + cols[None, :])
    b4 = tl.load(B4 + m * PADDED + pad)
    pb = tl.zeros((WIDTH,), tl.float32)
    pb4 = tl.zeros((PADDED,), tl.float32)
    total = 0.0
    top = 0.0
    for i in range(REPEAT):
        rows = (group * REPEAT + i) * BM + tl.arange(0, BM)
        y = tl.load(Y + (m * NP + rows)[:, None] * PADDED + pad[None, :]) + b4[None, :]
        row = tl.load(index + m * NP + rows)
        real = row < N
        true = tl.load(T + row[:, None] * PADDED + pad[None, :])
        e = tl.where(pad[None, :] < 6, y - true, 0.0)
        count = tl.load(counts + m * NC + row, mask=real, other=0).to(tl.float32)
        q = tl.sum(e * e, axis=1) / 6
        if focal:
            decay = tl.exp(-s * q)
            fade = 1 - decay
            L = alpha * fade * fade * q
            dL = alpha * (fade * fade + 2 * fade * s * decay * q)
        else:
            L = q
            dL = 1.0 + 0 * q
        total += tl.sum(count * L)
        g = (count * dL / 3)[:, None] * e
        gy = tl.minimum(tl.maximum(g * scale, -60000.0), 60000.0)
        pb4 += tl.sum(gy, axis=0)
        gy = gy.to(tl.float16)
        tl.store(GY + (m * NP + rows)[:, None] * PADDED + pad[None, :], gy)
        h = tl.load(H + own + rows[:, None] * WIDTH + cols[None, :])
        g = tl.where(h > 0, tl.dot(gy, w4t), 0.0)
        top = tl.maximum(top, tl.max(tl.max(tl.abs(g), axis=1)))
        g = tl.minimum(tl.maximum(g, -60000.0), 60000.0)
        pb += tl.sum(g, axis=0)
        tl.store(G + own + rows[:, None] * WIDTH + cols[None, :], g.to(tl.float16))
    tl.atomic_add(loss + m * 128 + t // every, total / B, sem="relaxed")
    tl.atomic_max(largest + m, top, sem="relaxed")
    place = m * GROUPS + group
    tl.store(PB4 + place * PADDED + pad, pb4)
    tl.store(PB + place * WIDTH + cols, pb)


@triton.jit
def mask(
    X,
    H,
    G,
    P0,
    PB,
    largest,
    NP,
    GROUPS,
    first: tl.constexpr,
    BM: tl.constexpr,
    REPEAT: tl.constexpr,
    WIDTH: tl.constexpr,
    PADDED: tl.constexpr,
):
    """Let gradients pass where a unit is active; sum them for the biases, and for the weights of the first layer."""
    group, m = tl.program_id(0), tl.program_id(1)
    cols = tl.arange(0, WIDTH)
    pad = tl.arange(0, PADDED)
    own = m.to(tl.int64) * NP * WIDTH
    p0 = tl.zeros((PADDED, WIDTH), tl.float32)
    pb = tl.zeros((WIDTH,), tl.float32)
    top = 0.0
    for i in range(REPEAT):
        rows = (group * REPEAT + i) * BM + tl.arange(0, BM)
        at = own + rows[:, None] * WIDTH + cols[None, :]
        g = tl.where(tl.load(H + at) > 0, tl.load(G + at).to(tl.float32), 0.0)
        top = tl.maximum(top, tl.max(tl.max(tl.abs(g), axis=1)))
        g = tl.minimum(tl.maximum(g, -60000.0), 60000.0)  # products may have left the range of float16
        pb += tl.sum(g, axis=0)
        if first:
            x = tl.load(X + (m * NP + rows)[:, None] * PADDED + pad[None, :])
            p0 = tl.dot(tl.trans(x), g.to(tl.float16), p0)
        else:
            tl.store(G + at, g.to(tl.float16))
    tl.atomic_max(largest + m, top, sem="relaxed")
    place = m * GROUPS + group
    tl.store(PB + place * WIDTH + cols, pb)
    if first:
        tl.store(P0 + place * PADDED * WIDTH + pad[:, None] * WIDTH + cols[None, :], p0)


@triton.jit
def adamw(P, G, M1, M2, n, step, factors, scale_in, B, beta_1, beta_2, eps, BLOCK: tl.constexpr):
    """Update parameters by the gradients of a minibatch."""
    i = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    ok = i < n
    t = tl.load(step)
    decay = tl.load(factors + t * 3)
    rate = tl.load(factors + t * 3 + 1)
    root = tl.load(factors + t * 3 + 2)
    g = tl.load(G + i, mask=ok) / (tl.load(scale_in) * B)
    m1 = beta_1 * tl.load(M1 + i, mask=ok) + (1 - beta_1) * g
    m2 = beta_2 * tl.load(M2 + i, mask=ok) + (1 - beta_2) * g * g
    tl.store(M1 + i, m1, mask=ok)
    tl.store(M2 + i, m2, mask=ok)
    p = tl.load(P + i, mask=ok) * decay - rate * m1 / (tl.sqrt(m2) * root + eps)
    tl.store(P + i, p, mask=ok)


def learning_rates(n, base=1e-3, least=1e-6, warm_up=0.01):
    """As tasks.residual.hyperparameters.learning_rate, for all n iterations."""
    n_warm = round(warm_up * n)
    i = np.arange(n, dtype=np.float64)
    decayed = base * (least / base) ** ((i - n_warm) / (n - 1 - n_warm))
    return np.where(i < n_warm, base * (i + 1) / max(n_warm, 1), decayed)


def generator(seed, *identity):
    """As tasks.seeding.generator."""
    digest = hashlib.sha256(json.JSONEncoder(allow_nan=False).encode(identity).encode()).digest()
    n_words = max(1, -(-seed.bit_length() // 32))
    words = np.frombuffer(seed.to_bytes(4 * n_words, "little") + digest, dtype="<u4")
    return np.random.default_rng(np.random.SeedSequence(words))


def initial_weights(seed, member, n_in=6):
    """As tasks.residual.network.initial_weights."""
    rng = generator(seed, "member", member)
    sizes = [n_in, W, W, W, W, N_OUT]
    out = {}
    for i, (a, b) in enumerate(pairwise(sizes)):
        bound = a**-0.5
        out[f"weight_{i}"] = rng.uniform(-bound, bound, (a, b)).astype(np.float32)
        out[f"bias_{i}"] = rng.uniform(-bound, bound, b).astype(np.float32)
    return out


class Ensemble:
    """Members that train side by side on one data set."""

    def __init__(
        self,
        x,
        targets,
        seed,
        members,
        n_iterations,
        batch=262_144,
        dropout=0.001,
        focal=True,
        bm=32,
        bk=8,
        warps=4,
        stages=2,
        dev="cuda",
    ):
        self.dev, self.M, self.batch, self.n_iterations = dev, len(members), batch, n_iterations
        M, N = self.M, len(x)
        self.N, self.bm, self.bk, self.warps, self.stages, self.focal, self.dropout = (
            N,
            bm,
            bk,
            warps,
            stages,
            focal,
            dropout,
        )
        self.split = 16 if N > 4096 else 1
        # rows that a batch holds at least once, with ten deviations to spare
        drawn = N * -math.expm1(-batch / N)
        drawn = min(N, drawn + 10 * (drawn * (1 - drawn / N)) ** 0.5)
        unit = math.lcm(bm * bk, self.split * 8)
        self.NP = NP = math.ceil(drawn / unit) * unit
        self.groups = NP // (bm * bk)
        f16, f32 = {"device": dev, "dtype": torch.float16}, {"device": dev, "dtype": torch.float32}
        high = torch.from_numpy(x).half()
        low = (torch.from_numpy(x) - high.float()).half()
        self.X = torch.zeros(N + 1, PAD, **f16)
        self.X[:N, :6], self.X[:N, 6:12] = high.to(dev), low.to(dev)
        self.x32, self.t32 = torch.from_numpy(x).to(dev), torch.from_numpy(targets).to(dev)
        self.T = torch.zeros(N + 1, PAD, **f32)
        self.T[:N, :N_OUT] = self.t32
        shapes = {
            "w0": (M, 6, W),
            "wh": (3, M, W, W),
            "w4": (M, W, N_OUT),
            "b0": (M, W),
            "bh": (3, M, W),
            "b4": (M, N_OUT),
        }
        self.n = sum(math.prod(shape) for shape in shapes.values())
        self.P, self.Gr, self.M1, self.M2 = (torch.zeros(self.n, **f32) for _ in range(4))
        self.p, self.g = self._views(self.P, shapes), self._views(self.Gr, shapes)
        for j, member in enumerate(members):
            w = initial_weights(seed, member)
            for name, value in (("w0", w["weight_0"]), ("w4", w["weight_4"]), ("b0", w["bias_0"]), ("b4", w["bias_4"])):
                self.p[name][j] = torch.from_numpy(value)
            for i in range(3):
                self.p["wh"][i, j], self.p["bh"][i, j] = (
                    torch.from_numpy(w[f"weight_{i + 1}"]),
                    torch.from_numpy(w[f"bias_{i + 1}"]),
                )
        self.W0, self.W4, self.W4T = (
            torch.zeros(M, PAD, W, **f16),
            torch.zeros(M, W, PAD, **f16),
            torch.zeros(M, PAD, W, **f16),
        )
        self.WH, self.WT = torch.zeros(3, M, W, W, **f16), torch.zeros(3, M, W, W, **f16)
        self.B4 = torch.zeros(M, PAD, **f32)
        self.H, self.G = torch.zeros(4, M, NP, W, **f16), torch.zeros(2, M, NP, W, **f16)
        groups = self.groups
        self.P0 = torch.zeros(M, groups, PAD, W, **f32)
        self.Xc, self.GY = torch.zeros(M, NP, PAD, **f16), torch.zeros(M, NP, PAD, **f16)
        self.PB, self.PB4 = torch.zeros(4, M, groups, W, **f32), torch.zeros(M, groups, PAD, **f32)
        self.every_row = torch.arange(-(-N // 1024) * 1024, device=dev).expand(M, -1).contiguous()
        self.index = torch.zeros(M, NP + 1, device=dev, dtype=torch.int64)
        self.B16 = torch.zeros(4, M, W, **f16)
        self.NC = NC = -(-N // 1024) * 1024
        self.counts = torch.zeros(M, NC, device=dev, dtype=torch.int32)
        self.loss, self.largest = torch.zeros(M, 128, **f32), torch.zeros(M, **f32)
        self.scale = torch.full((1,), 64.0, **f32)
        self.step = torch.zeros(1, device=dev, dtype=torch.int32)
        self.every = max(n_iterations // 100, 1)
        rate = learning_rates(n_iterations)
        t = np.arange(1, n_iterations + 1)
        table = np.stack([1 - rate * 0.01, rate / (1 - BETA_1**t), (1 - BETA_2**t) ** -0.5], 1)
        self.factors = torch.from_numpy(table.astype(np.float32)).to(dev)
        self.seed = int(generator(seed, "gpu", members[0]).integers(2**30))
        self._half()

    @staticmethod
    def _views(flat, shapes):
        out, first = {}, 0
        for name, shape in shapes.items():
            out[name] = flat[first : first + math.prod(shape)].view(shape)
            first += math.prod(shape)
        return out

    def _half(self):
        """Round to half precision; the factor for the units that are kept lies in the weights that follow."""
        p, keep = self.p, 1 / (1 - self.dropout)
        self.W0[:, :6].copy_(p["w0"])
        self.W0[:, 6:12].copy_(p["w0"])
        wh, w4 = p["wh"] * keep, p["w4"] * keep
        self.WH.copy_(wh)
        self.WT.copy_(wh.transpose(-1, -2))
        self.W4[:, :, :N_OUT].copy_(w4)
        self.W4T[:, :N_OUT].copy_(w4.transpose(-1, -2))
        self.B4[:, :N_OUT].copy_(p["b4"])
        self.B16[0].copy_(p["b0"])
        self.B16[1:].copy_(p["bh"])

    def gather(self):
        """List the rows that were drawn at least once."""
        present = self.counts > 0
        place = torch.cumsum(present.view(self.M, -1, 1024), 2, dtype=torch.int32)
        before = torch.cumsum(place[:, :, -1], 1, dtype=torch.int32) - place[:, :, -1]
        place = (place + before[:, :, None] - 1).view(self.M, -1)
        place = torch.where(present & (place < self.NP), place, self.NP).long()
        self.index.fill_(self.N)
        self.index.scatter_(1, place, self.every_row)
        self.rows = self.index[:, : self.NP].contiguous()
        n = self.M * self.NP
        gather_rows[(triton.cdiv(n, 128),)](self.X, self.rows, self.Xc, n, 128, PAD)

    def _product(self, a, b):
        """Multiply batches of matrices, with sums and results in float32."""
        return torch.bmm(a, b, out_dtype=torch.float32) if self.dev == "cuda" else a.float() @ b.float()

    def gradient(self):
        """Compute the gradient of the mean loss of the rows that were drawn, times the batch size and the scale."""
        keep, M, NP = 1 / (1 - self.dropout), self.M, self.NP
        self.gather()
        n_drawn = round(NP * W * self.dropout)
        for layer in range(4):
            for m in range(M):
                a = self.Xc[m] if layer == 0 else self.H[layer - 1, m]
                w = self.W0[m] if layer == 0 else self.WH[layer - 1, m]
                if self.dev == "cuda":
                    torch._addmm_activation(self.B16[layer, m], a, w, out=self.H[layer, m])
                else:
                    self.H[layer, m] = torch.relu(a.float() @ w.float() + self.B16[layer, m].float()).half()
            if n_drawn:
                drop[(triton.cdiv(n_drawn, 1024), M)](
                    self.H[layer], self.step, NP * W, n_drawn, self.seed + (layer + 1) * 1_000_003, 1024
                )
        g, S, last = self.g, self.split, self.G[1]
        output[(self.groups, M)](
            self.T,
            self.rows,
            self.counts,
            self._product(self.H[3], self.W4),
            self.GY,
            self.H[3],
            last,
            self.W4T,
            self.B4,
            self.PB[3],
            self.PB4,
            self.loss,
            self.largest,
            self.step,
            self.every,
            self.scale,
            self.N,
            self.NC,
            NP,
            self.groups,
            float(self.batch),
            1.0,
            100.0,
            self.focal,
            self.bm,
            self.bk,
            W,
            PAD,
            num_warps=self.warps,
            num_stages=self.stages,
        )

        def transposed(h):
            return h.view(M * S, NP // S, W).transpose(1, 2)

        part = self._product(transposed(self.H[3]), self.GY.view(M * S, NP // S, PAD)).view(M, S, W, PAD)
        g["w4"].copy_(part.sum(1)[:, :, :N_OUT] * keep)
        for layer in (2, 1, 0):
            part = self._product(transposed(self.H[layer]), last.view(M * S, NP // S, W))
            torch.sum(part.view(M, S, W, W), 1, out=g["wh"][layer])
            new = self.G[layer % 2]
            if self.dev == "cuda":
                torch.bmm(last, self.WT[layer], out=new)
            else:
                new.copy_(torch.bmm(last.float(), self.WT[layer].float()))
            mask[(self.groups, M)](
                self.Xc,
                self.H[layer],
                new,
                self.P0,
                self.PB[layer],
                self.largest,
                NP,
                self.groups,
                layer == 0,
                self.bm,
                self.bk,
                W,
                PAD,
                num_warps=self.warps,
                num_stages=self.stages,
            )
            last = new
        g["wh"].mul_(keep)
        p0 = self.P0.sum(1)
        g["w0"].copy_(p0[:, :6] + p0[:, 6:12])
        pb = self.PB.sum(2)
        g["b0"].copy_(pb[0])
        g["bh"].copy_(pb[1:])
        g["b4"].copy_(self.PB4.sum(1)[:, :N_OUT])

    def iterate(self):
        """Draw a minibatch and take a step."""
        self.counts.zero_()
        draw[(triton.cdiv(self.batch, 1024), self.M)](
            self.counts, self.step, self.N, self.NC, self.batch, self.seed, 1024
        )
        self.gradient()
        adamw[(triton.cdiv(self.n, 1024),)](
            self.P,
            self.Gr,
            self.M1,
            self.M2,
            self.n,
            self.step,
            self.factors,
            self.scale,
            float(self.batch),
            BETA_1,
            BETA_2,
            EPS,
            1024,
        )
        # the next scale puts the largest gradient of any layer below 2048: within float16, with room to grow
        top = self.largest.max().clamp(min=1e-6)
        self.scale.copy_((self.scale * torch.exp2(torch.floor(torch.log2(2048.0 / top)))).clamp(2.0**-10, 2.0**24))
        self.largest.zero_()
        self.step += 1
        self._half()

    def capture(self):
        """Record an iteration, to be replayed."""
        stream = torch.cuda.Stream()
        state = [t.clone() for t in (self.P, self.M1, self.M2, self.step, self.scale, self.loss)]
        with torch.cuda.stream(stream):
            for _ in range(2):
                self.iterate()
        torch.cuda.synchronize()
        self.graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(self.graph, stream=stream):
            self.iterate()
        for t, old in zip((self.P, self.M1, self.M2, self.step, self.scale, self.loss), state, strict=True):
            t.copy_(old)
        self.largest.zero_()
        self._half()
        torch.cuda.synchronize()

    @torch.no_grad()
    def predict(self):
        """(M, N, 6) predictions in float32 of the float32 weights, without dropout."""
        p, out = self.p, []
        for m in range(self.M):
            h = torch.relu(self.x32 @ p["w0"][m] + p["b0"][m])
            for layer in range(3):
                h = torch.relu(h @ p["wh"][layer, m] + p["bh"][layer, m])
            out.append(h @ p["w4"][m] + p["b4"][m])
        return torch.stack(out)

    @torch.no_grad()
    def full_loss(self):
        """(M,) mean loss over all rows, without dropout."""
        q = (self.predict() - self.t32).square().mean(-1)
        return (((-torch.expm1(-100 * q)) ** 2 * q) if self.focal else q).mean(1)

    def weights(self):
        """Return weight_i and bias_i of each layer i, members first."""
        p = self.p
        out = {}
        for i in range(5):
            w = p["w0"] if i == 0 else p["w4"] if i == 4 else p["wh"][i - 1]
            b = p["b0"] if i == 0 else p["b4"] if i == 4 else p["bh"][i - 1]
            out[f"weight_{i}"], out[f"bias_{i}"] = w.cpu().numpy().copy(), b.cpu().numpy().copy()
        return out


def check(e):
    """Compare the kernel's gradient with autograd's in float64, with the same counts and without dropout."""
    draw[(triton.cdiv(e.batch, 1024), e.M)](e.counts, e.step, e.N, e.NC, e.batch, e.seed + 7, 1024)
    e.dropout, old = 0.0, e.dropout
    e.scale.fill_(64.0)
    e._half()
    e.gradient()
    e.dropout = old
    e._half()
    p = {k: v.double().requires_grad_() for k, v in e.p.items()}
    total = 0
    for m in range(e.M):
        h = torch.relu(e.x32.double() @ p["w0"][m] + p["b0"][m])
        for layer in range(3):
            h = torch.relu(h @ p["wh"][layer, m] + p["bh"][layer, m])
        y = h @ p["w4"][m] + p["b4"][m]
        q = (y - e.t32.double()).square().mean(-1)
        L = (-torch.expm1(-100 * q)) ** 2 * q if e.focal else q
        total = total + (e.counts[m, : e.N].double() * L).sum()
    total.backward()
    worst = {}
    for k in p:
        own, true = e.g[k].double() / 64.0, p[k].grad
        worst[k] = float((own - true).norm() / true.norm())
    e.largest.zero_()
    e.loss.zero_()
    e.counts.zero_()
    return worst


def main():
    """Train the listed data sets one after the other; write a file for each."""
    torch.backends.cuda.matmul.allow_fp16_reduced_precision_reduction = False
    parser = argparse.ArgumentParser()
    parser.add_argument("--data", default="data.npz")
    parser.add_argument("--runs", default="0:50000", help="data set:iterations, and more after commas")
    parser.add_argument("--members", type=int, default=8)
    parser.add_argument("--out", type=Path, default=Path())
    options = parser.parse_args()
    data = np.load(options.data)
    for run in options.runs.split(","):
        k, n_iterations = map(int, run.split(":"))
        seed, members = int(data["seeds"][k]), list(range(options.members))
        ensemble = Ensemble(data[f"x{k}"], data[f"t{k}"], seed, members, n_iterations)
        print(f"data set {k}: errors of the gradient {check(ensemble)}", flush=True)
        ensemble.capture()
        began, losses = time.time(), []
        for done in range(0, n_iterations, ensemble.every):
            for _ in range(min(ensemble.every, n_iterations - done)):
                ensemble.graph.replay()
            losses.append(ensemble.full_loss().cpu().numpy())
            if not np.isfinite(losses[-1]).all():
                raise SystemExit(f"data set {k}: the loss is {losses[-1]} by iteration {done + ensemble.every}")
        seconds = time.time() - began
        np.savez(
            options.out / f"data-set-{k}-{n_iterations}.npz",
            **ensemble.weights(),
            iteration=np.minimum(np.arange(1, len(losses) + 1) * ensemble.every, n_iterations),
            training_loss=ensemble.loss[:, : len(losses)].cpu().numpy() / ensemble.every,
            loss=np.stack(losses, 1),
            seconds=seconds,
        )
        print(f"data set {k}: {n_iterations} iterations in {seconds:.0f} s, loss {losses[-1]}", flush=True)


if __name__ == "__main__":
    main()
