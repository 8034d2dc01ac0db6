"""Training of one ensemble member. Paper, "Neural Network Training".

The transitions, settings, seed and member's number determine the result: a second run gives the same bytes on the same
machine and device. All members of a study hold out the same throws.
"""

import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.optim.adamw import adamw

from tasks.arrays import Float32, Float64
from tasks.residual.error_report import ErrorRow, error_rows
from tasks.residual.hyperparameters import Architecture, Training
from tasks.residual.network import ResidualNetwork, Standardisation
from tasks.residual.observation import INPUTS, OBSERVATION, STATE, Observed
from tasks.residual.throws import MeasuredTransitions, Transitions
from tasks.residual.validation import split_throws
from tasks.seeding import generator

_N_CURVE_POINTS = 100  # approximate number of points of a learning curve
_FLOOR = 0.1  # share of the residuals' deviation below which their uncertainty does not matter


class TrainingDiverged(ArithmeticError):  # noqa: N818 (what happened, as in a rollout's status)
    """The loss of a member is not finite."""


class NoDevice(RuntimeError):  # noqa: N818 (what is the case)
    """torch does not find the requested device."""


@dataclass(frozen=True, eq=False)
class TrainedMember:
    """One network, its learning curve, and its errors on held-out throws."""

    weights: dict[str, Float32]  # weight_i (n_in, n_out), bias_i (n_out,) of each layer i, for standardised quantities
    standardisation: Standardisation  # standardisation of the training set
    inputs: tuple[Observed, ...]  # what the network observes
    learning_curve: Float64  # (n_points, 3) iteration, mean training loss since the previous point, validation loss
    validation: tuple[ErrorRow, ...]  # errors on the held-out throws, in SI units

    def arrays(self) -> dict[str, Float32]:
        """Return all that inference needs by name: weights, standardisation, and inputs if not the paper's."""
        arrays = {**self.weights, **asdict(self.standardisation)}
        if self.inputs != OBSERVATION:
            arrays["inputs"] = np.array([list(INPUTS).index(name) for name in self.inputs], np.float32)
        return arrays


def learning_rate(training: Training, iteration: int) -> float:
    """Return the rate at an iteration from 0: a linear warm-up, then exponential decay to the least rate at the end."""
    n_warm_up = round(training.warm_up * training.n_iterations)
    if iteration < n_warm_up:
        return training.learning_rate * (iteration + 1) / n_warm_up
    decayed = (iteration - n_warm_up) / (training.n_iterations - 1 - n_warm_up)
    return training.learning_rate * math.pow(training.min_learning_rate / training.learning_rate, decayed)


def precision_weights(residual: Float32, residual_sd: Float32) -> Float32:
    """Return the weights of uncertain residuals: inverse variances, 1 at most.

    The weight is f² / (f² + sd²). The floor f is a tenth of the residuals' deviation, far below what networks of a
    study get wrong: that a residual is known better than so earns it no more weight.

    Args:
        residual, residual_sd: (n_rows, 6) residuals and their deviations.
    """
    floor = np.maximum(_FLOOR * residual.std(axis=0, dtype=np.float64), np.finfo(np.float32).tiny)
    weights: Float32 = (1 / (1 + np.square(residual_sd / floor))).astype(np.float32)
    return weights


def mean_loss(training: Training, predicted: Tensor, true: Tensor, weight: Tensor | None = None) -> Tensor:
    """Return the mean loss over rows.

    L_mse = ‖φ(o) - e‖² / 6, and the focal loss is α (1 - exp(-s L_mse))^γ L_mse.

    Args:
        training: the loss and its parameters.
        predicted: (n_rows, 6) predicted residuals φ(o).
        true: (n_rows, 6) residuals e.
        weight: (n_rows, 6) weights of squared errors, where residuals are uncertain.
    """
    squared = (predicted - true).square()
    L_mse = (squared if weight is None else weight * squared).mean(dim=1)
    if training.loss == "mse":
        return L_mse.mean()
    weight = (-torch.expm1(-training.focal_s * L_mse)) ** training.focal_gamma
    return training.focal_alpha * (weight * L_mse).mean()


def weight_updates(parameters: Sequence[Tensor], weight_decay: float) -> Callable[[float], None]:
    """Return the update of AdamW, which takes a learning rate and changes parameters in place by their gradients.

    It is the function behind torch.optim.AdamW. The class would import torch's compiler, which takes each process that
    trains 2 to 6 s.
    """
    mean, mean_square = ([torch.zeros_like(parameter) for parameter in parameters] for _ in range(2))
    n_updates = [torch.zeros((), device=parameter.device) for parameter in parameters]

    @torch.no_grad()
    def update(rate: float) -> None:
        gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
        adamw(
            list(parameters),
            gradients,
            mean,
            mean_square,
            [],
            n_updates,
            fused=True,
            amsgrad=False,
            beta1=0.9,
            beta2=0.999,
            lr=rate,
            weight_decay=weight_decay,
            eps=1e-8,
            maximize=False,
        )

    return update


def n_cuda_devices() -> int:
    """Count the CUDA devices that torch can use here."""
    return torch.cuda.device_count() if torch.cuda.is_available() else 0


def train_member(
    transitions: Transitions,
    architecture: Architecture,
    training: Training,
    *,
    seed: int,
    member: int,
    on_progress: Callable[[int, float], None] | None = None,
) -> TrainedMember:
    """Return one network, trained on one CPU thread or one CUDA device; the data stay on the device.

    Args:
        transitions: the data set.
        architecture: the network's size.
        training: settings of the training.
        seed: the study's seed; it determines the held-out throws.
        member: index in the ensemble; with the seed, it determines all other randomness.
        on_progress: called after each iteration with the number of iterations done and the minibatch's loss.

    Raises:
        NoDevice: torch finds no CUDA device.
        TrainingDiverged: the loss is not finite.
        ValueError: there are fewer than two throws.
    """
    if training.device == "cuda" and not n_cuda_devices():
        built = f"was built for CUDA {torch.version.cuda}" if torch.version.cuda else "was built without CUDA"
        raise NoDevice(f"training.device is 'cuda', but torch {torch.__version__}, which {built}, finds no CUDA device")
    to_learn, to_validate = map(np.flatnonzero, split_throws(transitions.throw, training.held_out, seed=seed))
    observed = transitions.observed(architecture.observation)
    standardisation = Standardisation.of(
        observed[to_learn], transitions.residual[to_learn], standardise_targets=training.standardise_targets
    )

    weights = None
    if isinstance(transitions, MeasuredTransitions):
        weights = precision_weights(transitions.residual, transitions.residual_sd)

    def standardised(rows: npt.NDArray[np.intp]) -> Tensor:
        observation = standardisation.standard_observation(observed[rows])
        residual = standardisation.standard_residual(transitions.residual[rows])
        weight = [] if weights is None else [weights[rows]]
        return torch.from_numpy(np.concatenate((observation, residual, *weight), axis=1)).to(training.device)

    torch_seed = int(generator(seed, "member", member).integers(2**63))
    with _deterministic(torch_seed, torch.device(training.device)):
        network = ResidualNetwork(architecture).to(training.device)
        validation_set = standardised(to_validate)
        curve = _fit(network, standardised(to_learn), validation_set, training, member, on_progress)
        predicted = _predict(network, validation_set[:, : observed.shape[1]]).cpu().numpy()

    vx, vy = transitions.state[to_validate, 3], transitions.state[to_validate, 4]
    return TrainedMember(
        weights=network.arrays(),
        standardisation=standardisation,
        inputs=architecture.observation,
        learning_curve=curve,
        validation=error_rows(standardisation.residual(predicted), transitions.residual[to_validate], np.hypot(vx, vy)),
    )


def _fit(
    network: ResidualNetwork,
    training_set: Tensor,
    validation_set: Tensor,
    training: Training,
    member: int,
    on_progress: Callable[[int, float], None] | None,
) -> Float64:
    """Train in place on (n_rows, n_inputs + 6) observations and residuals, and 6 weights; return the learning curve."""
    parameters = list(network.parameters())
    update = weight_updates(parameters, training.weight_decay)
    n_rows, n_observed = len(training_set), network.n_inputs
    curve = []
    losses = []
    for iteration in range(training.n_iterations):
        drawn = torch.randint(n_rows, (training.batch_size,), device=training_set.device)
        batch = training_set.index_select(0, drawn)
        loss = mean_loss(training, network(batch[:, :n_observed]), *_targets(batch, n_observed))
        for parameter in parameters:
            parameter.grad = None
        loss.backward()  # type: ignore[no-untyped-call]
        update(learning_rate(training, iteration))

        done = iteration + 1
        losses.append(_finite(loss, "training", member, done))
        if on_progress is not None:
            on_progress(done, losses[-1])
        if done % max(training.n_iterations // _N_CURVE_POINTS, 1) == 0 or done == training.n_iterations:
            predicted = _predict(network, validation_set[:, :n_observed])
            validation_loss = mean_loss(training, predicted, *_targets(validation_set, n_observed))
            curve.append((done, float(np.mean(losses)), _finite(validation_loss, "validation", member, done)))
            losses.clear()
    return np.array(curve)


def _targets(rows: Tensor, n_observed: int) -> tuple[Tensor, ...]:
    """Return the (n_rows, 6) residuals and, if there are any, their weights."""
    residual, weight = rows[:, n_observed : n_observed + len(STATE)], rows[:, n_observed + len(STATE) :]
    return (residual, weight) if weight.shape[1] else (residual,)


def _finite(loss: Tensor, name: str, member: int, iteration: int) -> float:
    value = loss.item()
    if not math.isfinite(value):
        raise TrainingDiverged(
            f"member {member}: the {name} loss is {value} at iteration {iteration}; "
            f"lower learning_rate, or check the transitions for values that are not finite"
        )
    return value


def _predict(network: ResidualNetwork, observation: Tensor) -> Tensor:
    network.eval()
    with torch.inference_mode():
        predicted: Tensor = network(observation)
    network.train()
    return predicted


@contextmanager
def _deterministic(seed: int, device: torch.device) -> Iterator[None]:
    """Seed torch and restrict it to one thread and deterministic algorithms; restore its state afterwards."""
    n_threads, mode = torch.get_num_threads(), torch.get_deterministic_debug_mode()
    if device.type == "cuda":
        os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # without it cuBLAS refuses to be deterministic
    with torch.random.fork_rng(devices=[device] if device.type == "cuda" else []):
        try:
            torch.manual_seed(seed)
            torch.set_num_threads(1)
            torch.set_deterministic_debug_mode("error")  # use_deterministic_algorithms would import torch's compiler
            yield
        finally:
            torch.set_num_threads(n_threads)
            torch.set_deterministic_debug_mode(mode)
