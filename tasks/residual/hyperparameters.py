"""What a settings file may choose about the networks and their training. Paper, "Neural Network Training".

[P] marks what the paper says; the others are our decisions.
"""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from tasks.parameters import Parameters


class Architecture(Parameters):
    """A multilayer perceptron with ReLU."""

    hidden_layers: int = Field(default=4, ge=1, le=16)
    """[P]"""
    width: int = Field(default=256, ge=1, le=4096)
    """Units in each hidden layer. [P]"""
    dropout: float = Field(default=0.001, ge=0.0, le=0.9)
    """Probability that a hidden unit is dropped from one sample of a minibatch. [P]"""


class Training(Parameters):
    """How one network learns the residuals."""

    n_iterations: int = Field(default=50_000, ge=10, le=10_000_000)
    """Steps of AdamW. [P]"""
    batch_size: int = Field(default=262_144, ge=1, le=2**24)
    """Transitions in a minibatch, drawn with replacement. [P]"""
    learning_rate: float = Field(default=1e-3, gt=0.0, le=1.0)
    """After warm-up. [P] Short trainings want more: 2 × 32 for 10 s on a core did best at 1e-2, batch size 2,048."""
    min_learning_rate: float = Field(default=1e-6, gt=0.0, le=1.0)
    """Where the exponential decay ends, at the last iteration. [P]"""
    warm_up: float = Field(default=0.01, ge=0.0, le=0.5)
    """Share of the iterations over which the rate rises from zero. The paper says short; 1 % is 500 of its 50,000."""
    weight_decay: float = Field(default=0.01, ge=0.0, le=10.0)
    """Of AdamW, which the paper leaves open: torch's default."""
    loss: Literal["focal", "mse"] = "focal"
    """How samples count: by the focal weight [P], which suppresses small errors, or all alike."""
    focal_alpha: float = Field(default=1.0, gt=0.0, le=1e6)
    """α: the focal loss's scale. [P]"""
    focal_s: float = Field(default=100.0, gt=0.0, le=1e6)
    """s: a sample counts in full once its squared error is well above 1/s. [P]"""
    focal_gamma: float = Field(default=2.0, ge=1.0, le=100.0)
    """γ: how sharply smaller errors lose weight. [P]"""
    standardise_targets: bool = True
    """Take the loss on residuals divided by their deviation; in SI units only the largest components would count."""
    held_out: float = Field(default=0.1, gt=0.0, lt=1.0)
    """Share of the throws kept for validation; whole throws, because the steps of one resemble each other."""
    device: Literal["cpu", "cuda"] = "cpu"
    """What trains: a core, or a GPU a member. They differ in the last bits, and so in the network that comes of it:
    hence it is chosen here and not taken as found, for one settings file has to mean one study on every machine."""

    @model_validator(mode="after")
    def _decays(self) -> Self:
        if self.min_learning_rate > self.learning_rate:
            raise ValueError(
                f"min_learning_rate is {self.min_learning_rate}, expected at most learning_rate, {self.learning_rate}"
            )
        return self
