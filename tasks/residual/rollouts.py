"""The medium that is fitted to whole paths of free bars, for cameras that are slower than what they film.

A spinning bar loses most of its spin between two frames, and no smoother that knows nothing of drag can tell how. So
the medium is fitted by rollouts: from a start that is estimated too, the base simulator of a free link steps with the
model's velocity changes,

    v <- v + change(length, pose, v) + gravity dt,    pose <- pose + dt v

and its poses at the frames are compared with those seen, each in units of its uncertainty (multiple shooting; Bock &
Plitt 1984). The starts of all windows are eliminated by variable projection (Golub & Pereyra 1973; Kaufman 1975): the
model learns from what remains of the residuals r outside the span of their derivatives by the start,

    S = dr / d start = Q R,    loss = |r - Q Qᵀ r|²

The changes are those of wetted networks (see forms/wetted.py), whose forces act on the part A_s and J of a link that is
under water. Between frames at which a spin dies out, stronger drag on a faster spin looks nearly the same. What decides
is a form that fluids have in common: drag grows with the square of the speed relative to the fluid,

    f_t = -D_t |u| u_t,    f_n = -D_n |u| u_n,    f_ω = -κ |ω| ω + b_ω,    u = v - flow

beside a buoyancy b = (b_x, b_y). All of D_t, D_n, κ > 0, b, b_ω and the flow are one small network's functions of the
link's length, depth and angle and of the angle at which the fluid meets it. It begins as constants, and as drag only
slows a bar down, no rollout, however long, grows beyond all bounds. Half a turn makes no difference to a bar.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim.adamw import adamw

from tasks.arrays import Bools, Float64
from tasks.residual.descent_kernel import BETA_1, BETA_2, EPSILON
from tasks.residual.torch_descent import one_thread
from tasks.residual.training import TrainingDiverged
from tasks.world import LinkStates, Physics, VelocityChange
from tasks.world.slush import submerged_part

_WIDTH = 16
_FIRST = 1.0, 1.0, 2.0, 0.0, 1.0, 0.0, 0.0  # log D_t, log D_n, log κ; b_x, b_y, b_ω over gravity; the flow [m/s]
_SEED = 1
_BATCH, _RATE, _WARM_UP = 192, 2e-2, 20
_WINDOW = 6  # intervals between frames in a rollout; the next one begins at the last but one of its frames
_LONGEST = 1.5  # typical intervals between frames, on average, in a window
_RELINEARISE = 40  # iterations between estimates of the starts
_LEAST_SD = 1e-3  # of a pose [m], [rad]: sharper ones are as good as exact
_ROBUST = 10.0  # mean squared residual from which a window counts less
_FARTHEST = 6.0  # height or depth beyond which it has no more effect [m]
_STEP = 0.3  # of finite differences, in units of a start's uncertainty


@dataclass(frozen=True, eq=False)
class SeenPaths:
    """Poses of bars at frames, padded to the longest; axis 0 is the throw, axis 1 the frame."""

    time: Float64  # (n_throws, n_frames) [s]; padding repeats the last
    pose: Float64  # (n_throws, n_frames, 3) x, y [m], angle, unwrapped [rad]
    sd: Float64  # (n_throws, n_frames, 3) deviations of the measurements
    velocity: Float64  # (n_throws, n_frames, 3) first estimates [m/s, m/s, rad/s]
    seen: Bools  # (n_throws, n_frames) False in padding
    begins: Bools  # (n_throws, n_frames) frames that do not follow from those before: the first, after gaps, at walls
    length_scale: Float64  # (n_throws,) long axes [m]

    def __getitem__(self, throws: Bools) -> SeenPaths:
        """Select throws by a mask."""
        return SeenPaths(*(getattr(self, field.name)[throws] for field in fields(self)))


class MediumModel(nn.Module):
    """Velocity changes of a step: quadratic drag and buoyancy on what is under water. A medium of the simulator."""

    def __init__(self, physics: Physics) -> None:
        """Begin with constant coefficients; torch's current seed determines how they will vary."""
        super().__init__()
        self._dt, self._gravity = physics.time_step, physics.gravity
        last = nn.Linear(_WIDTH, len(_FIRST))
        nn.init.zeros_(last.weight)
        last.bias = nn.Parameter(torch.tensor(_FIRST))
        hidden = nn.Linear(7, _WIDTH), nn.SiLU(), nn.Linear(_WIDTH, _WIDTH), nn.SiLU()
        self.coefficients = nn.Sequential(*hidden, last).double()

    def forward(self, length_scale: Tensor, pose: Tensor, velocity: Tensor) -> Tensor:
        """Return the (n, 3) changes of vx, vy and ω in a step.

        Args:
            length_scale: (n,) long axes [m].
            pose: (n, 3) x, y [m], angle [rad].
            velocity: (n, 3) vx, vy [m/s], ω [rad/s].
        """
        a, y, cos, sin = length_scale, pose[:, 1], pose[:, 2].cos(), pose[:, 2].sin()
        A_s, I_s = cast("tuple[Tensor, Tensor]", submerged_part(*cast("Any", (a, y, cos, sin))))
        J = 12 * I_s / (a * a + 1 / (a * a))
        vx, vy, omega = velocity.unbind(dim=1)
        along, across = cos * vy - sin * vx, cos * vx + sin * vy
        square = along * along + across * across + 1e-6
        twice_the_angle = cos * cos - sin * sin, 2 * cos * sin
        twice_the_attack = (along * along - across * across) / square, 2 * along * across / square
        depth = y.clamp(-_FARTHEST, _FARTHEST) / 2
        inputs = torch.stack((a - 2, 2 * A_s - 1, depth, *twice_the_angle, *twice_the_attack), dim=1)
        log_D_t, log_D_n, log_kappa, b_x, b_y, b_omega, flow = self.coefficients(inputs).unbind(dim=1)

        # Implicit in the speed at the start of the step, as in after_drag: no speed grows, whatever the coefficients.
        u_t, u_n = along + sin * flow, across - cos * flow
        u_dt = self._dt * A_s * (u_t * u_t + u_n * u_n + 1e-12).sqrt()
        k_t, k_n, k_omega = log_D_t.exp() * u_dt, log_D_n.exp() * u_dt, self._dt * J * log_kappa.exp() * omega.abs()
        by_along, by_across = -u_t * k_t / (1 + k_t), -u_n * k_n / (1 + k_n)
        fall = self._gravity * self._dt
        return torch.stack(
            (
                cos * by_across - sin * by_along + fall * A_s * b_x,
                sin * by_across + cos * by_along + fall * A_s * b_y,
                -omega * k_omega / (1 + k_omega) + fall * J * b_omega,
            ),
            dim=1,
        )

    @torch.no_grad()
    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:  # noqa: ARG002 (that of the fit)
        """Return the changes of links, in the precision of their states."""
        columns = (links.length_scale, links.y, np.arctan2(links.sin, links.cos), links.vx, links.vy, links.omega)
        a, y, *rest = (torch.from_numpy(column.ravel().astype(np.float64)) for column in columns)
        change = self(a, torch.stack((torch.zeros_like(y), y, rest[0]), dim=1), torch.stack(rest[1:], dim=1))
        return VelocityChange(*change.numpy().astype(links.y.dtype).T.reshape(3, *links.y.shape))


class _Windows:
    """Frames that one rollout has to meet; axis 0 is the window, axis 1 its frames, padded to the most."""

    def __init__(self, paths: SeenPaths, parts: Sequence[tuple[int, int, int]], dt: float) -> None:
        """Select frames: the throw, its first frame and their number for each window."""
        throw, first, number = (np.array(column, dtype=np.int64) for column in zip(*parts, strict=True))
        frame = first[:, None] + np.minimum(np.arange(number.max()), number[:, None] - 1)
        at = throw[:, None], frame
        interval = float(np.median(np.diff(paths.time, axis=1)[paths.seen[:, 1:]]))
        sd = np.maximum(paths.sd[at], _LEAST_SD)
        self.dt = dt
        self.throw, self.first = throw, first
        self.length_scale = torch.from_numpy(paths.length_scale[throw])
        self.steps = torch.from_numpy((paths.time[at] - paths.time[throw, first][:, None]) / dt)  # after the start
        self.pose, self.sd = torch.from_numpy(paths.pose[at]), torch.from_numpy(sd)
        self.counts = torch.from_numpy((np.arange(frame.shape[1]) < number[:, None]).astype(np.float64))[:, :, None]
        self.velocity = torch.from_numpy(paths.velocity[throw, first])
        self.range = torch.from_numpy(paths.velocity[paths.seen].std(axis=0) + 1e-6)  # prior deviation of a velocity
        self.start = torch.cat([self.pose[:, 0], self.velocity], dim=1)  # (n, 6) poses and velocities, to be estimated
        self.unit = torch.cat([self.sd[:, 0], self.sd[:, 0] / interval], dim=1)

    def __len__(self) -> int:
        return len(self.throw)

    def residuals(self, model: MediumModel, gravity: float, rows: Tensor, start: Tensor) -> Tensor:
        """Return (n, 3 n_frames + 3) differences from the frames, and of velocities from their first estimates."""
        steps = self.steps[rows]
        poses, _ = _rollout(model, self.length_scale[rows], start, _n_steps(steps), self.dt, gravity)
        off = self.counts[rows] * (_at(poses, steps) - self.pose[rows]) / self.sd[rows]
        prior = (start[:, 3:] - self.velocity[rows]) / self.range
        return torch.cat([off.flatten(1), prior], dim=1)

    @torch.no_grad()
    def estimate_starts(self, model: MediumModel, gravity: float, n_sweeps: int) -> Tensor:
        """Improve the starts by Levenberg and Marquardt's method; return (n, n_residuals, 6) bases of S."""
        n, every = len(self), torch.arange(len(self))
        damping = torch.full((n,), 1e-3, dtype=torch.float64)
        for sweep in range(n_sweeps + 1):
            moved = self.start.repeat(7, 1, 1)
            moved[1:] += _STEP * torch.eye(6, dtype=torch.float64)[:, None] * self.unit
            r = self.residuals(model, gravity, every.repeat(7), moved.reshape(-1, 6)).reshape(7, n, -1)
            S = ((r[1:] - r[0]) / _STEP).permute(1, 2, 0)
            if sweep == n_sweeps:
                break
            normal = S.transpose(1, 2) @ S
            diagonal = torch.diagonal(normal, dim1=1, dim2=2) + 1e-3
            normal += torch.diag_embed(damping[:, None] * diagonal)
            change = torch.linalg.solve(normal, S.transpose(1, 2) @ r[0][:, :, None])[:, :, 0]
            tried = self.start - change * self.unit
            left = self.residuals(model, gravity, every, tried).square().sum(dim=1)
            better = left < r[0].square().sum(dim=1)
            self.start = torch.where(better[:, None], tried, self.start)
            damping = torch.where(better, damping / 3, damping * 5)
        basis: Tensor = torch.linalg.qr(S).Q
        return basis


def _n_steps(steps: Tensor) -> int:
    return max(int(np.ceil(float(steps.max()) - 1e-6)), 1)


def _rollout(
    model: MediumModel, length_scale: Tensor, start: Tensor, n_steps: int, dt: float, gravity: float
) -> tuple[Tensor, Tensor]:
    """Return (n_steps + 1, n, 3) poses and velocities of (n, 6) starts, in the order of FreeLinks.step."""
    fall = torch.tensor([0.0, -gravity * dt, 0.0], dtype=torch.float64)
    pose, velocity = start[:, :3], start[:, 3:]
    poses, velocities = [pose], [velocity]
    for _ in range(n_steps):
        velocity = velocity + model(length_scale, pose, velocity) + fall
        pose = pose + dt * velocity
        poses.append(pose)
        velocities.append(velocity)
    return torch.stack(poses), torch.stack(velocities)


def _at(path: Tensor, steps: Tensor) -> Tensor:
    """Return (n, n_times, 3) values of a path after any (n, n_times) numbers of steps, linear between whole ones."""
    before = steps.long().clamp(max=len(path) - 2)
    row = torch.arange(len(steps))[:, None]
    earlier, later = path[before, row], path[before + 1, row]
    return earlier + (steps - before)[:, :, None] * (later - earlier)


@contextmanager
def _deterministic() -> Iterator[None]:
    """Restrict torch to one thread and deterministic algorithms; restore its state afterwards."""
    mode = torch.get_deterministic_debug_mode()
    try:
        torch.set_deterministic_debug_mode("error")  # use_deterministic_algorithms would import torch's compiler
        with one_thread():
            yield
    finally:
        torch.set_deterministic_debug_mode(mode)


def fit_medium(paths: SeenPaths, physics: Physics, *, n_iterations: int = 200) -> MediumModel:
    """Fit a model of the medium to the frames of throws, on one CPU thread; a second run gives the same."""
    with torch.random.fork_rng(devices=[]), _deterministic():
        torch.manual_seed(_SEED)
        model = MediumModel(physics)
        windows = _Windows(paths, _parts(paths), physics.time_step)
        parameters: list[Tensor] = list(model.parameters())
        mean, mean_square = ([torch.zeros_like(parameter) for parameter in parameters] for _ in range(2))
        n_updates = [torch.zeros(()) for _ in parameters]
        Q = windows.estimate_starts(model, physics.gravity, n_sweeps=5)
        for iteration in range(n_iterations):
            if iteration and iteration % _RELINEARISE == 0:
                Q = windows.estimate_starts(model, physics.gravity, n_sweeps=2)
            rows = torch.randperm(len(windows))[:_BATCH]
            r = windows.residuals(model, physics.gravity, rows, windows.start[rows])[:, :, None]
            squared = (r - Q[rows] @ (Q[rows].transpose(1, 2) @ r)).square().mean(dim=(1, 2))
            for parameter in parameters:
                parameter.grad = None
            (_ROBUST * torch.log1p(squared / _ROBUST)).mean().backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(parameters, 1.0)
            warm_up = min((iteration + 1) / _WARM_UP, 1.0)
            # The function behind torch.optim.AdamW, which would import torch's compiler, for 2 to 6 s.
            with torch.no_grad():
                adamw(
                    parameters,
                    [cast("Tensor", parameter.grad) for parameter in parameters],
                    mean,
                    mean_square,
                    [],
                    n_updates,
                    fused=True,
                    amsgrad=False,
                    beta1=BETA_1,
                    beta2=BETA_2,
                    lr=warm_up * _RATE * (1 + math.cos(math.pi * iteration / n_iterations)) / 2,
                    weight_decay=0.01,
                    eps=EPSILON,
                    maximize=False,
                )
    return model


def _sections(paths: SeenPaths) -> list[tuple[int, int, int]]:
    """Return the throw, the first frame and the number of frames of each section that is one motion."""
    found = []
    for throw, frames in enumerate(paths.seen.sum(axis=1).tolist()):
        begins = [*np.flatnonzero(paths.begins[throw, :frames]).tolist(), frames]
        found += [(throw, first, last - first) for first, last in pairwise(begins)]
    return found


def _parts(paths: SeenPaths) -> list[tuple[int, int, int]]:
    """Divide the sections into windows that overlap by one interval."""
    longest = _LONGEST * _WINDOW * float(np.median(np.diff(paths.time, axis=1)[paths.seen[:, 1:]]))
    parts = []
    for throw, first, number in _sections(paths):
        for begin in range(first, first + max(number - 2, 1), _WINDOW - 1):
            n = min(_WINDOW + 1, first + number - begin)
            time = paths.time[throw, begin : begin + n]
            parts.append((throw, begin, int(np.count_nonzero(time - time[0] <= longest))))
    return parts


@torch.no_grad()
def persistence(model: MediumModel, paths: SeenPaths, physics: Physics) -> float:
    """Return the correlation of successive errors, each of a frame that is predicted from the seven frames before.

    Measurements alone leave about 0 (the whiteness of innovations; Mehra 1970). NaN if all throws are shorter.
    """
    n, dt, sections = _WINDOW + 1, physics.time_step, _sections(paths)
    parts = [(throw, first + k, n) for throw, first, number in sections if number > n + 1 for k in range(number - n)]
    if not parts:
        return math.nan
    with _deterministic():
        windows = _Windows(paths, parts, dt)
        windows.estimate_starts(model, physics.gravity, n_sweeps=8)
        at = windows.throw, windows.first + n
        steps = torch.from_numpy((paths.time[at] - paths.time[windows.throw, windows.first])[:, None] / dt)
        poses, _ = _rollout(model, windows.length_scale, windows.start, _n_steps(steps), dt, physics.gravity)
    off = (_at(poses, steps)[:, 0].numpy() - paths.pose[at]) / np.maximum(paths.sd[at], _LEAST_SD)
    follows = (np.diff(windows.throw) == 0) & (np.diff(windows.first) == 1)
    last, then = off[:-1][follows], off[1:][follows]
    return float(np.sum(last * then) / np.sqrt(np.sum(last**2) * np.sum(then**2)))


@torch.no_grad()
def follow(model: MediumModel, paths: SeenPaths, times: Float64, physics: Physics) -> tuple[Float64, Float64]:
    """Roll whole throws out, from the starts that meet their frames best.

    Args:
        model: of the medium.
        paths: the throws.
        times: (n_throws, n_times) times from the first frame on [s].
        physics: constants of the base simulator.

    Returns:
        (n_throws, n_times, 3) poses and velocities at the times.
    """
    sections, dt = _sections(paths), physics.time_step
    with _deterministic():
        windows = _Windows(paths, sections, dt)
        windows.estimate_starts(model, physics.gravity, n_sweeps=15)
        since = paths.time[windows.throw, windows.first][:, None]
        at = torch.from_numpy(np.maximum((times[windows.throw] - since) / dt, 0.0))
        rollouts = _rollout(model, windows.length_scale, windows.start, _n_steps(at), dt, physics.gravity)
        states = torch.stack([_at(series, at) for series in rollouts]).numpy()
    found = np.empty((2, *times.shape, 3))
    for row, (throw, first, _) in enumerate(sections):  # each until the next one of the throw begins
        after = times[throw] >= paths.time[throw, first]
        found[:, throw, after] = states[:, row, after]
    if not np.isfinite(found).all():
        raise TrainingDiverged("the model of the medium diverged: check the tracks, and film more throws")
    return found[0], found[1]
