"""Residual dynamics, learned from throws. Paper, "Neural Network Training".

This package imports no torch, so that reading a settings file is fast; :mod:`tasks.residual.training` does.
"""

from tasks.residual.error_report import ErrorRow, error_rows
from tasks.residual.forms import FORMS, Form, form_named
from tasks.residual.hyperparameters import Architecture, Training
from tasks.residual.learner import LEARNERS, NO_LEARNERS, Learner, LearnerSettings, arm_kind, in_order
from tasks.residual.robot_ranges import robot_ranges
from tasks.residual.throws import STATE, MeasuredTransitions, Throws, Transitions, initial_states, simulate_throws
