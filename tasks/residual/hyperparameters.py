"""Settings of the networks and their training. Paper, "Neural Network Training".

[P] marks values of the paper; the others are our decisions.
"""

import math
from itertools import pairwise
from typing import Literal, Self

from pydantic import Field, model_validator

from tasks.parameters import Parameters
from tasks.residual.forms import Form, form_here, form_named
from tasks.residual.forms.plain import PLAIN


class Architecture(Parameters):
    """A multilayer perceptron with ReLU."""

    hidden_layers: int = Field(default=4, ge=1, le=16)
    """Number of hidden layers. [P]"""
    width: int = Field(default=256, ge=1, le=4096)
    """Units in each hidden layer. [P]"""
    dropout: float = Field(default=0.001, ge=0.0, le=0.9)
    """Probability to drop a hidden unit from a sample of a minibatch. [P]"""
    form: str = "plain"
    """What networks know of links, a file in tasks/residual/forms: nothing [P]; "signed_angle", which way they lean,
    for media that push a tilted plate sideways; or "wetted", which part is under water. The last need several times
    fewer throws, and fewest of a fluid at rest: of that they learn from the mirror image of every throw, too. "law"
    fits the constants of the slush and no network, "law_and_network" lets networks learn what that leaves over; the law
    of another medium is "law:flowing_slush". "wetted_mass" also predicts which share of what joints and motors do to a
    link the fluid takes back: use struck throws."""

    @property
    def about(self) -> str:
        """What the form is, in a sentence for a page; "" if that is said, or its code is not here."""
        form = form_here(self.form)
        return form.about if form else ""

    @property
    def sizes(self) -> list[int]:
        """Numbers of inputs, of units in each hidden layer, and of outputs in training."""
        form = form_named(self.form)
        return [len(form.inputs), *self._hidden_of(form), len(form.learned)]

    def _hidden_of(self, form: Form) -> list[int]:
        return [self.width] * self.hidden_layers if form.learned else [1]  # a unit that does nothing, if none learns

    @property
    def n_weights(self) -> int:
        """Weights of the matrices, without biases: the multiplications that one prediction takes.

        A form whose code is not here counts as the paper's.
        """
        form = form_here(self.form) or PLAIN
        ends = len(form.inputs) + len(form.unseen), len(form.learned) + form.n_factors
        return sum(n_in * n_out for n_in, n_out in pairwise([ends[0], *self._hidden_of(form), ends[1]]))

    @property
    def flops(self) -> int:
        """Floating-point operations of one prediction."""
        return 2 * self.n_weights


class Training(Parameters):
    """Training of one network on the residuals."""

    n_iterations: int = Field(default=50_000, ge=10, le=10_000_000)
    """Steps of AdamW. [P]"""
    batch_size: int = Field(default=262_144, ge=1, le=2**24)
    """Transitions in a minibatch, drawn with replacement. [P]"""
    learning_rate: float = Field(default=1e-3, gt=0.0, le=1.0)
    """Rate after warm-up. [P] Short runs need more: 2 × 32 units in 10 s did best at 1e-2 with batches of 2,048."""
    min_learning_rate: float = Field(default=1e-6, gt=0.0, le=1.0)
    """Rate at the last iteration, the end of the decay. [P]"""
    decay: Literal["exponential", "cosine"] = "exponential"
    """How the rate decays after warm-up: exponentially [P], or as half a period of a cosine. With a long warm-up and a
    high rate (0.3 and 3e-2) the latter halves the errors of wetted networks of few throws."""
    warm_up: float = Field(default=0.01, ge=0.0, le=0.5)
    """Share of the iterations in which the rate rises from zero. The paper says short; 1 % is 500 of its 50,000."""
    weight_decay: float = Field(default=0.01, ge=0.0, le=10.0)
    """Weight decay of AdamW: torch's default, because the paper does not state it."""
    loss: Literal["focal", "mse"] = "focal"
    """Weights of samples: "focal" [P] suppresses small errors, "mse" weights all equally."""
    focal_alpha: float = Field(default=1.0, gt=0.0, le=1e6)
    """α: scale of the focal loss. [P]"""
    focal_s: float = Field(default=100.0, gt=0.0, le=1e6)
    """s: a sample has full weight if its squared error is well above 1/s. [P]"""
    focal_gamma: float = Field(default=2.0, ge=1.0, le=100.0)
    """γ: how sharply smaller errors lose weight. [P]"""
    standardise_targets: bool = True
    """Divide residuals by their deviation in the loss; in SI units only the largest components would count."""
    held_out: float = Field(default=0.1, ge=0.0, lt=1.0)
    """Share of the throws held out for validation; whole throws, because the steps of one resemble each other. 0 trains
    on every throw [P] and measures errors on the same throws. Of tracked throws it is always a quarter."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Device for training: one core for each member, or one GPU for all members of a data set. Results differ in the
    last bits, so the device is a setting and not detected: a settings file must describe the same study on every
    machine."""
    products: Literal["float32", "tf32", "half"] = Field(default="float32", exclude_if=lambda value: value == "float32")
    """Precision of matrix products on a GPU, whose sums are in float32: "tf32" rounds factors to 11 bits of 24, "half"
    units and gradients between hidden layers, too, which moves half the memory. On a core it is float32."""

    @model_validator(mode="after")
    def _agrees(self) -> Self:
        if self.min_learning_rate > self.learning_rate:
            raise ValueError(
                f"min_learning_rate is {self.min_learning_rate}, expected at most learning_rate, {self.learning_rate}"
            )
        if self.device == "cpu" and self.products != "float32":
            raise ValueError(
                f"products is {self.products} and device is cpu: expected device cuda, or products float32"
            )
        return self


def learning_rate(training: Training, iteration: int) -> float:
    """Return the rate at an iteration from 0: a linear warm-up, then decay to the least rate at the end."""
    n_warm_up = round(training.warm_up * training.n_iterations)
    if iteration < n_warm_up:
        return training.learning_rate * (iteration + 1) / n_warm_up
    decayed = (iteration - n_warm_up) / (training.n_iterations - 1 - n_warm_up)
    highest, least = training.learning_rate, training.min_learning_rate
    if training.decay == "cosine":
        return least + (highest - least) * (1 + math.cos(math.pi * decayed)) / 2
    return highest * math.pow(least / highest, decayed)
