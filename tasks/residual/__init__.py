"""What the base simulator misses, learned from throws. Paper, "Neural Network Training".

Here is what needs no torch, so that reading a settings file does not wait for it; :mod:`tasks.residual.training` and
:mod:`tasks.residual.ensemble` are imported by those who train and those who simulate.
"""

from tasks.residual.error_report import ErrorRow, error_rows
from tasks.residual.hyperparameters import Architecture, Training
from tasks.residual.observation import OBSERVATION, STATE, observe
from tasks.residual.throws import Starts, Throws, Transitions, initial_states, simulate_throws

__all__ = [
    "OBSERVATION",
    "STATE",
    "Architecture",
    "ErrorRow",
    "Starts",
    "Throws",
    "Training",
    "Transitions",
    "error_rows",
    "initial_states",
    "observe",
    "simulate_throws",
]
