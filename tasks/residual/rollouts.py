"""A model of the medium that is fitted to whole paths of free bars, for cameras that are slower than what they film.

A spinning bar loses most of its spin between two frames, and no smoother that knows nothing of drag can tell how. So
the medium is fitted by rollouts: from a start that is estimated too, the base simulator of a free link steps with the
model's velocity changes,

    v <- v + change(length, pose, v) + gravity dt,    pose <- pose + dt v

and its poses at the frames are compared with those seen, each in units of its uncertainty (multiple shooting; Bock &
Plitt 1984). The starts of all windows are eliminated by variable projection (Golub & Pereyra 1973; Kaufman 1975): the
model learns from what remains of the residuals r outside the span of their derivatives by the start,

    S = dr / d start = Q R,    loss = |r - Q Qᵀ r|²

Between frames at which a spin dies out, stronger drag on a faster spin looks nearly the same. What decides is the
model's form, which every fluid has in common: drag grows with the square of the speed relative to the fluid,

    dv/dt = -|u| D u + b,    u = v - flow,    dω/dt = -κ |ω| ω + b_ω

with D = M Mᵀ (2, 2), κ, b (3) and flow (2) functions of the bar's length, height and angle, as small networks, and a
network of the whole state beside them for what this misses. As D has no negative eigenvalue, drag only slows a bar
down, and as inputs far from those of the throws count as less far, what networks add is bounded: no rollout, however
long, grows beyond all bounds. Half a turn makes no difference to a bar.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn

from tasks.arrays import Bools, Float64
from tasks.residual.throws import MeasuredTransitions
from tasks.residual.torch_descent import deterministic, weight_updates
from tasks.residual.training import TrainingDiverged, precision_weights
from tasks.world import Physics

_WIDTH = 32
_SEED = 1
_FIRST_BATCH, _FIRST_RATE = 512, 1e-2  # the fit to residuals of single steps
_BATCH, _RATE = 192, 2e-3  # the fit to rollouts
_FLAT, _DECAY = 0.6, 5e-3  # share of the iterations at the full rate, and the share of it at the end
_WINDOW = 6  # intervals between frames in a rollout; the next one begins at the last but one of its frames
_LONGEST = 1.5  # typical intervals between frames, on average, in a window
_RELINEARISE = 100  # iterations between estimates of the starts
_FLOOR = 0.1  # share of the residuals' deviation that poses need not resolve, as in precision_weights
_LEAST = 1e-3  # deviation of an input or a residual that counts as a change [m, 1, m/s, rad/s]
_ROBUST = 10.0  # mean squared residual from which a window counts less
_FARTHEST = 5.0  # deviations from the mean beyond which an input has no more effect
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


class MediumModel(nn.Module):
    """Velocity changes of a step: quadratic drag and buoyancy, with coefficients that networks predict."""

    def __init__(self, transitions: MeasuredTransitions, time_step: float) -> None:
        """Initialise from torch's current seed, with the scales of first estimates."""
        super().__init__()
        self._dt = time_step
        inputs = _inputs(*_of_transitions(transitions))
        self._mean, deviation = inputs.mean(dim=0), inputs.std(dim=0)
        self._deviation = torch.where(deviation > _LEAST, deviation, 1.0)  # what never changes is not scaled up
        scale = np.maximum(transitions.residual[:, 3:].astype(np.float64).std(axis=0), _LEAST)
        self.residual_deviation = torch.from_numpy(scale)
        self.coefficients = _network(4, 10)
        self.rest = _network(7, 3)
        for parameter in self.rest[-1].parameters():
            nn.init.zeros_(parameter)

    def forward(self, length_scale: Tensor, pose: Tensor, velocity: Tensor) -> Tensor:
        """Return the (n, 3) changes of vx, vy and ω in a step.

        Args:
            length_scale: (n,) long axes [m].
            pose: (n, 3) x, y [m], angle [rad].
            velocity: (n, 3) vx, vy [m/s], ω [rad/s].
        """
        inputs = ((_inputs(length_scale, pose, velocity) - self._mean) / self._deviation).clamp(-_FARTHEST, _FARTHEST)
        coefficients = self.coefficients(inputs[:, :4])
        root, kappa, b = coefficients[:, :4].reshape(-1, 2, 2), 10 * coefficients[:, 4], 10 * coefficients[:, 5:8]
        D = 10 * root @ root.transpose(1, 2)
        u, omega = velocity[:, :2] - coefficients[:, 8:], velocity[:, 2]
        # Implicit in the drag's mean k = tr D / 2: no eigenvalue exceeds 2 k, so that the speed never grows.
        speed_dt = self._dt * (u.square().sum(dim=1, keepdim=True) + 1e-12).sqrt()
        drag = torch.bmm(D, u[:, :, None])[:, :, 0]
        mean_drag = (D[:, 0, :1] + D[:, 1, 1:]) / 2
        lost = self._dt * nn.functional.softplus(kappa) * omega.abs()
        by_drag = torch.cat(
            [-drag * speed_dt / (1 + mean_drag * speed_dt), (-omega * lost / (1 + lost))[:, None]], dim=1
        )
        change: Tensor = by_drag + self._dt * b + self.residual_deviation * self.rest(inputs)
        return change


def _network(n_in: int, n_out: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(n_in, _WIDTH), nn.SiLU(), nn.Linear(_WIDTH, _WIDTH), nn.SiLU(), nn.Linear(_WIDTH, n_out)
    ).double()


def _inputs(length_scale: Tensor, pose: Tensor, velocity: Tensor) -> Tensor:
    twice = 2 * pose[:, 2]
    return torch.cat([torch.stack([length_scale, pose[:, 1], twice.cos(), twice.sin()], dim=1), velocity], dim=1)


def _of_transitions(transitions: MeasuredTransitions) -> tuple[Tensor, Tensor, Tensor]:
    state = torch.from_numpy(transitions.state.astype(np.float64))
    return torch.from_numpy(transitions.length_scale.astype(np.float64)), state[:, :3], state[:, 3:]


class _Windows:
    """Frames that one rollout has to meet; axis 0 is the window, axis 1 its frames, padded to the most."""

    def __init__(self, paths: SeenPaths, parts: Sequence[tuple[int, int, int]], model: MediumModel, dt: float) -> None:
        """Select frames: the throw, its first frame and their number for each window."""
        throw, first, number = (np.array(column, dtype=np.int64) for column in zip(*parts, strict=True))
        frame = first[:, None] + np.minimum(np.arange(number.max()), number[:, None] - 1)
        at = throw[:, None], frame
        interval = np.diff(paths.time, axis=1)[paths.seen[:, 1:]]
        steps_apart = max(float(np.median(interval)) / dt, 1.0)
        # What a share of the residuals' deviation adds to a pose from one frame to the next is as good as exact.
        floor = _FLOOR * model.residual_deviation.numpy() * dt * steps_apart**2 / 2
        sd = np.hypot(paths.sd[at], floor)
        self.dt = dt
        self.throw, self.first = throw, first
        self.length_scale = torch.from_numpy(paths.length_scale[throw])
        self.steps = torch.from_numpy((paths.time[at] - paths.time[throw, first][:, None]) / dt)  # after the start
        self.pose, self.sd = torch.from_numpy(paths.pose[at]), torch.from_numpy(sd)
        self.counts = torch.from_numpy((np.arange(frame.shape[1]) < number[:, None]).astype(np.float64))[:, :, None]
        velocity = torch.from_numpy(paths.velocity[throw, first])
        self.range = torch.from_numpy(paths.velocity[paths.seen].std(axis=0) + 1e-6)  # prior deviation of a velocity
        self.velocity = velocity
        self.start = torch.cat([self.pose[:, 0], velocity], dim=1)  # (n, 6) poses and velocities, to be estimated
        self.unit = torch.cat([self.sd[:, 0], self.sd[:, 0] / (steps_apart * dt)], dim=1)

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
        bases = []
        for rows in torch.split(torch.arange(len(self)), 1024):
            n = len(rows)
            start, unit = self.start[rows], self.unit[rows]
            damping = torch.full((n,), 1e-3, dtype=torch.float64)
            for sweep in range(n_sweeps + 1):
                moved = start.repeat(7, 1, 1).reshape(7, n, 6)
                moved[1:] += _STEP * torch.eye(6, dtype=torch.float64)[:, None] * unit
                r = self.residuals(model, gravity, rows.repeat(7), moved.reshape(-1, 6)).reshape(7, n, -1)
                S = ((r[1:] - r[0]) / _STEP).permute(1, 2, 0)
                if sweep == n_sweeps:
                    bases.append(torch.linalg.qr(S).Q)
                    break
                normal = S.transpose(1, 2) @ S
                diagonal = torch.diagonal(normal, dim1=1, dim2=2) + 1e-3
                normal += torch.diag_embed(damping[:, None] * diagonal)
                change = torch.linalg.solve(normal, S.transpose(1, 2) @ r[0][:, :, None])[:, :, 0]
                tried = start - change * unit
                left = self.residuals(model, gravity, rows, tried).square().sum(dim=1)
                better = left < r[0].square().sum(dim=1)
                start = torch.where(better[:, None], tried, start)
                damping = torch.where(better, damping / 3, damping * 5)
            self.start[rows] = start
        return torch.cat(bases)


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


def fit_medium(
    paths: SeenPaths,
    transitions: MeasuredTransitions,
    physics: Physics,
    *,
    n_first_iterations: int = 3000,
    n_iterations: int = 1500,
) -> MediumModel:
    """Fit a model of the medium to the frames of throws.

    Args:
        paths: the throws.
        transitions: their residuals, as a smoother estimates them, for a first fit.
        physics: constants of the base simulator.
        n_first_iterations: iterations of the first fit, to single steps.
        n_iterations: iterations of the fit to rollouts.

    Returns:
        The model, on one CPU thread; a second run gives the same.
    """
    with torch.random.fork_rng(devices=[]), deterministic(torch.device("cpu")):
        torch.manual_seed(_SEED)
        model = MediumModel(transitions, physics.time_step)
        _fit_steps(model, transitions, n_first_iterations)
        windows = _Windows(paths, _parts(paths), model, physics.time_step)
        _fit_rollouts(model, windows, physics.gravity, n_iterations)
    return model


def _fit_steps(model: MediumModel, transitions: MeasuredTransitions, n_iterations: int) -> None:
    weights = torch.from_numpy(precision_weights(transitions.residual, transitions.residual_sd)[:, 3:])
    residual = torch.from_numpy(transitions.residual[:, 3:])
    inputs = _of_transitions(transitions)
    parameters = list(model.parameters())
    update = weight_updates(parameters, weight_decay=0.01)
    for iteration in range(n_iterations):
        rows = torch.randint(len(residual), (_FIRST_BATCH,))
        predicted = model(*(values[rows] for values in inputs))
        loss = (weights[rows] * ((predicted - residual[rows]) / model.residual_deviation).square()).mean()
        _descend(loss, parameters)
        update(_FIRST_RATE * 0.01 ** (iteration / n_iterations))


def _fit_rollouts(model: MediumModel, windows: _Windows, gravity: float, n_iterations: int) -> None:
    parameters = list(model.parameters())
    update = weight_updates(parameters, weight_decay=0.01)
    Q = windows.estimate_starts(model, gravity, n_sweeps=5)
    shuffled = torch.randperm(len(windows))
    for iteration in range(n_iterations):
        if iteration and iteration % _RELINEARISE == 0:
            Q = windows.estimate_starts(model, gravity, n_sweeps=2)
        if len(shuffled) < min(_BATCH, len(windows)):
            shuffled = torch.randperm(len(windows))
        rows, shuffled = shuffled[:_BATCH], shuffled[_BATCH:]
        r = windows.residuals(model, gravity, rows, windows.start[rows])[:, :, None]
        squared = (r - Q[rows] @ (Q[rows].transpose(1, 2) @ r)).square().mean(dim=(1, 2))
        _descend((_ROBUST * torch.log1p(squared / _ROBUST)).mean(), parameters)
        nn.utils.clip_grad_norm_(parameters, 1.0)
        done = iteration / n_iterations
        warm_up = min((iteration + 1) / 50, 1.0)
        update(warm_up * _RATE * _DECAY ** max((done - _FLAT) / (1 - _FLAT), 0.0))


def _descend(loss: Tensor, parameters: Sequence[Tensor]) -> None:
    for parameter in parameters:
        parameter.grad = None
    loss.backward()  # type: ignore[no-untyped-call]


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
def follow(model: MediumModel, paths: SeenPaths, times: Float64, physics: Physics) -> tuple[Float64, Float64, Float64]:
    """Roll whole throws out, from the starts that meet their frames best.

    Args:
        model: of the medium.
        paths: the throws.
        times: (n_throws, n_times) times from the first frame on [s].
        physics: constants of the base simulator.

    Returns:
        (n_throws, n_frames, 3) poses at the frames, and (n_throws, n_times, 3) poses and velocities at the times.

    Raises:
        TrainingDiverged: a state is not finite.
    """
    sections = _sections(paths)
    dt = physics.time_step
    with deterministic(torch.device("cpu")):
        windows = _Windows(paths, sections, model, dt)
        windows.estimate_starts(model, physics.gravity, n_sweeps=15)
        since = paths.time[windows.throw, windows.first][:, None]
        at_frames, at_times = (
            torch.from_numpy(np.maximum((time[windows.throw] - since) / dt, 0.0)) for time in (paths.time, times)
        )
        n_steps = max(_n_steps(at_frames), _n_steps(at_times))
        poses, velocities = _rollout(model, windows.length_scale, windows.start, n_steps, dt, physics.gravity)
        rolled_out = [
            _at(series, at).numpy() for series, at in ((poses, at_frames), (poses, at_times), (velocities, at_times))
        ]
    found = np.empty_like(paths.pose), np.empty((*times.shape, 3)), np.empty((*times.shape, 3))
    for row, (throw, first, _) in enumerate(sections):  # each until the next one of the throw begins
        begin = paths.time[throw, first]
        for whole, series, at in zip(found, rolled_out, (paths.time, times, times), strict=True):
            whole[throw, at[throw] >= begin] = series[row, at[throw] >= begin]
    if not all(np.isfinite(array).all() for array in found):
        raise TrainingDiverged("the model of the medium diverged: check the tracks, or set tracks.fit to steps")
    return found
