"""Training of one ensemble member. Paper, "Neural Network Training".

The transitions, settings, seed and member's number determine the result. On a CPU a second run gives the same bytes, on
another processor as well; on a CUDA device, on the same machine. All members of a study hold out the same simulated
throws, and of tracked throws those that the medium of their data was not fitted to.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numba
import numpy as np
from numpy.random import Generator

from tasks.arrays import Bools, Float32, Float64, Floats, Int64
from tasks.residual.current import current, is_current
from tasks.residual.descent import Descent, Weights
from tasks.residual.ensemble import Ensemble
from tasks.residual.error_report import ErrorRow, error_rows
from tasks.residual.forms import Form, Targets, form_named, observe, symmetric_copies, velocity_changes
from tasks.residual.hyperparameters import Architecture, Training
from tasks.residual.network import Standardisation, initial_weights
from tasks.residual.throws import MeasuredTransitions, Transitions, precision_weights
from tasks.residual.torch_descent import TorchDescent, require_device, row_losses
from tasks.seeding import generator
from tasks.world import Physics

SMALL = Architecture(hidden_layers=2, width=48)
QUICK = Training(
    n_iterations=3000, batch_size=2048, learning_rate=0.03, warm_up=0.3, decay="cosine", weight_decay=0.03, loss="mse"
)
"""What :func:`learn` trains by default: networks for a notebook."""

_N_CURVE_POINTS = 100  # approximate number of points of a learning curve


class TrainingDiverged(ArithmeticError):  # noqa: N818 (what happened, as in a rollout's status)
    """The loss of a member is not finite."""


@dataclass(frozen=True, eq=False)
class TrainedMember:
    """One network, its learning curve, and its errors on held-out throws."""

    weights: dict[str, Float32]  # weight_i (n_in, n_out), bias_i (n_out,) of each layer i, for standardised quantities
    standardisation: Standardisation  # standardisation of the training set
    form: Form
    learning_curve: Float64  # (n_points, 3) iteration, mean training loss since the previous point, validation loss
    validation: tuple[ErrorRow, ...]  # errors on the held-out throws, in SI units
    law: dict[str, Floats]  # constants and factors of a form that fits some
    time_step: float  # of the throws [s]

    def arrays(self) -> dict[str, Any]:
        """Return all that inference needs by name, the form's name in UTF-8."""
        form, time_step = np.frombuffer(self.form.name.encode(), np.uint8), np.array([self.time_step])
        return {**self.weights, **asdict(self.standardisation), **self.law, "form": form, "time_step": time_step}


def split_throws(throw: Int64, held_out: float, *, seed: int) -> tuple[Bools, Bools]:
    """Return masks of the transitions to learn from and of those to validate on, the same for all members.

    Whole throws are held out at random, because the steps of one resemble each other: at least one throw, and not all.
    If the share is 0, networks learn from every throw, as in the paper, and are validated on the same throws.
    ``throw`` is the throw of each transition. Raises ValueError if there are fewer than two.
    """
    if held_out == 0:
        every = np.ones(len(throw), dtype=bool)
        return every, every
    throws = np.unique(throw)
    if len(throws) < 2:
        raise ValueError(f"transitions of {len(throws)} throws, expected at least 2: one to train on, one held out")
    n_held_out = min(max(round(held_out * len(throws)), 1), len(throws) - 1)
    validated = np.isin(throw, generator(seed, "held out").permutation(throws)[:n_held_out])
    return ~validated, validated


def learn(
    throws: Transitions | Sequence[Transitions] | Any,
    *,
    n_members: int = 4,
    network: Architecture = SMALL,
    training: Training = QUICK,
    seed: int = 1,
    physics: Physics | None = None,
) -> Ensemble:
    """Train an ensemble on throws as studies do, on one core.

    ``puddle.learn(puddle.throw("true_slush"))`` takes half a minute. With few throws and iterations:

    >>> throws = puddle.throw("true_slush", puddle.Throws(n_throws=20, n_steps=30))
    >>> ensemble = puddle.learn(throws, n_members=2, training=puddle.Training(n_iterations=20, batch_size=64))
    >>> learned = puddle.ResidualSlush(depth=9.0, ensemble=ensemble)
    >>> designs = puddle.random_designs(8, np.random.default_rng(seed=1))
    >>> puddle.simulate(designs, learned).displacement.shape  # of each member [m]
    (2, 8)

    Args:
        throws: those of ``puddle.throw``, or of ``puddle.record``, or a list of them; or your own: a table, such as a
            data frame, with a row per time step, throw by throw, and the columns throw, a whole number;
            length_scale, the long axis [m]; x and y of the centre, over the surface [m]; angle [rad]; vx, vy [m/s];
            omega [rad/s].
        n_members: number of networks.
        network: size and form of a network, by default 2 × 48 units.
        training: settings of the training, by default of a quick one.
        seed: of the networks and of which throws are held out.
        physics: constants of the base simulator, that of the throws; the paper's by default, with steps of 1/60 s.

    Raises:
        TrainingDiverged: a loss is not finite.
        ValueError: the table lacks a column, there are fewer than two throws, or no members.
    """
    if n_members < 1:
        raise ValueError(f"n_members is {n_members}, expected at least 1")
    physics, given = physics or Physics(), throws if isinstance(throws, list | tuple) else [throws]
    known = [one if isinstance(one, Transitions) else Transitions.of_states(one, physics) for one in given]
    data, members = Transitions.of_several(known), range(n_members)
    trained = [train_member(data, network, training, seed=seed, member=k, physics=physics) for k in members]
    return Ensemble.from_members([member.arrays() for member in trained])


def train_member(
    transitions: Transitions,
    architecture: Architecture,
    training: Training,
    *,
    seed: int,
    member: int,
    physics: Physics | None = None,
) -> TrainedMember:
    """Return one network; see :func:`train_members`."""
    return train_members([transitions], architecture, training, seed=seed, members=[member], physics=physics)[0]


def train_members(
    transitions: Sequence[Transitions],
    architecture: Architecture,
    training: Training,
    *,
    seed: int,
    members: Sequence[int],
    physics: Physics | None = None,
) -> list[TrainedMember]:
    """Return networks: trained one after the other on one CPU thread, or all at once on one CUDA device.

    Args:
        transitions: the data set of each.
        architecture: the networks' size.
        training: settings of the training.
        seed: the study's seed; it determines the held-out throws.
        members: index of each in the ensemble; with the seed, it determines all other randomness.
        physics: constants of the base simulator, which the fit of a law needs; the paper's by default.

    Raises:
        NoDevice: torch finds no CUDA device.
        OutOfDeviceMemory: its memory does not hold a minibatch.
        TrainingDiverged: the loss is not finite.
        UnfittedLaw: the throws do not determine the constants of a law.
        ValueError: there are fewer than two throws.
    """
    require_device(training)
    lessons = [
        _lesson(data, architecture, training, seed, member, physics or Physics())
        for data, member in zip(transitions, members, strict=True)
    ]
    if not form_named(architecture.form).learned:
        return [lesson.finish(lesson.weights) for lesson in lessons]
    if training.device == "cuda" or numba.config.DISABLE_JIT:
        weights, learned, rngs = zip(*((one.weights, one.learned, one.rng) for one in lessons), strict=True)
        by_torch = TorchDescent(weights, learned, architecture.dropout, training, rngs)
        return _learn(by_torch, lessons, training, members)
    trained = []
    for lesson, member in zip(lessons, members, strict=True):
        on_a_core = Descent(lesson.weights, *lesson.learned, architecture.dropout, training, lesson.rng)
        trained += _learn(on_a_core, [lesson], training, [member])
    return trained


@dataclass(frozen=True, eq=False)
class _Lesson:
    """What a network begins with and learns."""

    weights: Weights
    learned: tuple[Float32, Targets]  # standardised
    held_out: tuple[Float32, Targets]
    rng: Generator
    finish: Callable[..., TrainedMember]
    """Describes the member by its weights and, if its form learns, its curve and outputs for what is held out."""


def _lesson(
    transitions: Transitions, architecture: Architecture, training: Training, seed: int, member: int, physics: Physics
) -> _Lesson:
    """Split the throws, fit the law, and standardise what that leaves over."""
    if isinstance(transitions, MeasuredTransitions):
        split = ~transitions.held_out, transitions.held_out
    else:
        split = split_throws(transitions.throw, training.held_out, seed=seed)
    to_learn, to_validate = map(np.flatnonzero, split)
    times = _times_drawn(transitions.throw, to_learn, generator(seed, "resample", member))
    if isinstance(transitions, MeasuredTransitions):  # members differ by what few throws leave open
        to_learn = np.repeat(to_learn, times[to_learn].astype(int))
    form = form_named(architecture.form)
    links, residual = transitions.links(physics), transitions.residual[:, -form.n_errors :]
    read, weights = observe(form, links), np.ones_like(residual)
    if isinstance(transitions, MeasuredTransitions):  # a camera sees x and y alike, so any other axes, too
        weights = precision_weights(transitions.residual, transitions.residual_sd)[:, -form.n_errors :]

    def changes_by(outputs: Float32, read: Float32) -> Float32:
        factors = np.broadcast_to(law.get("factors", np.empty(0)), (len(read), form.n_factors))
        return velocity_changes(form, np.concatenate((outputs, factors), axis=1).astype(np.float32), read)

    law, left_over = dict[str, Floats](), residual
    if form.constants:
        law["constants"], law["factors"] = form.fit(links, residual, weights * times[:, None], physics)
        left_over = residual - changes_by(np.zeros((len(read), len(form.outputs)), np.float32), read)
    examples = read, form.measured(read, left_over), weights
    learned, held_out = (tuple(array[rows] for array in examples) for rows in (to_learn, to_validate))
    mirrored = bool(form.mirror) and not is_current(*current(transitions[to_learn]))
    learned = symmetric_copies(form, *learned, mirrored=mirrored)
    seen = slice(len(form.inputs))
    choices = {"standardise_targets": training.standardise_targets}
    standardisation = Standardisation.of(learned[0][:, seen], learned[1], **choices)

    def standardised(read: Float32, change: Float32, weights: Float32) -> tuple[Float32, Targets]:
        standard = standardisation.standard_residual(change)
        targets = form.targets(read, standard, weights, standardisation.residual_deviation)
        return standardisation.standard_observation(read[:, seen]), targets

    def finish(
        weights: dict[str, Float32], curve: Float64 | None = None, standard: Float32 | None = None
    ) -> TrainedMember:
        if curve is None or standard is None:
            squared = np.square(left_over / residual.std(axis=0)).mean(axis=1)
            curve = np.array([[1, squared[to_learn].mean(), squared[to_validate].mean()]])
            outputs = np.empty((len(to_validate), 0), np.float32)
        else:
            outputs = standardisation.residual(standard)
        beside, acting = np.split(outputs, [len(form.beside)], axis=1)
        predicted = np.concatenate((beside, changes_by(acting, read[to_validate])), axis=1)
        speed = np.hypot(transitions.state[to_validate, 3], transitions.state[to_validate, 4])
        errors = error_rows(predicted, residual[to_validate], speed)
        return TrainedMember(weights, standardisation, form, curve, errors, law, physics.time_step)

    rng = generator(seed, "member", member)
    return _Lesson(
        initial_weights(architecture.sizes, rng), standardised(*learned), standardised(*held_out), rng, finish
    )


def _times_drawn(throw: Int64, learned: Int64, rng: Generator) -> Float32:
    """Draw as many throws as are learned from, with replacement; return how often that of each row was drawn."""
    throws, which = np.unique(throw[learned], return_inverse=True)
    times = np.zeros(len(throw), np.float32)
    times[learned] = rng.multinomial(len(throws), np.full(len(throws), 1 / len(throws)))[which]
    return times


def _learn(
    descent: Descent | TorchDescent, lessons: Sequence[_Lesson], training: Training, members: Sequence[int]
) -> list[TrainedMember]:
    """Take all iterations, and return the members with their learning curves."""
    every = max(training.n_iterations // _N_CURVE_POINTS, 1)
    curves: list[list[tuple[int, float, float]]] = [[] for _ in lessons]
    for first in range(0, training.n_iterations, every):
        losses = descent.advance(min(every, training.n_iterations - first))
        done = first + losses.shape[1]
        outputs = descent.predict([lesson.held_out[0] for lesson in lessons])
        for lesson, member, curve, own, predicted in zip(lessons, members, curves, losses, outputs, strict=True):
            _check_finite(own, "training", member, first + 1)
            validation_loss = float(row_losses(training, predicted.astype(np.float64), lesson.held_out[1]).mean())
            _check_finite(np.array([validation_loss]), "validation", member, done)
            curve.append((done, float(own.mean()), validation_loss))
    trained = zip(lessons, descent.weights(), curves, outputs, strict=True)
    return [lesson.finish(weights, np.array(curve), predicted) for lesson, weights, curve, predicted in trained]


def _check_finite(losses: Float64, name: str, member: int, first: int) -> None:
    """Raise TrainingDiverged if a loss is not finite; the first is that of iteration number ``first``."""
    for i in np.flatnonzero(~np.isfinite(losses)):
        raise TrainingDiverged(
            f"member {member}: the {name} loss is {losses[i]} at iteration {first + i}; "
            f"lower learning_rate, or check the transitions for values that are not finite"
        )
