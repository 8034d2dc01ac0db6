"""Contacts that a kit does not have: links on known paths, and a robot that folds onto itself."""

import numpy as np
import pytest

from tasks.fabrication.built_bodies import mechanism_of
from tasks.fabrication.contacts import passing_contacts
from tasks.fabrication.kit_settings import KitSettings
from tasks.fabrication.rods import Layers
from tasks.simulation.box2d import TOTAL_RADIUS

DT = 0.1


def apart(n_steps: int) -> np.ndarray:
    """Poses of six upright links, 2 m by 0.5 m, 10 m from one another."""
    pose = np.zeros((n_steps, 6, 3))
    pose[..., 0] = 10.0 * np.arange(6)
    return pose


def test_two_links_that_come_together(crane):
    # Part 1 is links 0 and 1, part 2 is 2 and 3, part 3 is 4 and 5; parts 2 and 3 lie in the layer that 1 does not.
    mechanism = mechanism_of(crane, KitSettings())
    layers = Layers((True, False, False), ((), (), ()))
    pose = apart(30)
    # Link 3 approaches link 0 at 0.5 m/s. Their centres start 1.2 m apart: a gap of 0.7 m, of which 0.02 m is skin.
    # Step k ends after k + 1 time steps.
    pose[:, 3, 0] = 1.2 - 0.5 * DT * (np.arange(30) + 1)
    (found,) = passing_contacts(crane, mechanism, layers, pose, time_step=DT)
    assert (found.links, found.parts, found.joints) == ((0, 3), (0, 1), (2,))
    first = np.ceil((0.7 - TOTAL_RADIUS) / 0.5 / DT)
    assert found.first == pytest.approx(first * DT)
    assert found.share == pytest.approx((30 - first + 1) / 30)
    turned = pose.copy()
    turned[:, 3, 2] = np.pi / 2  # lying, it is 2 m wide and touches link 0 from the start
    (at_once,) = passing_contacts(crane, mechanism, layers, turned, time_step=DT)
    assert at_once.first == pytest.approx(DT) and at_once.share == 1.0


def test_joined_links_and_parts_of_one_layer_are_not_reported(crane):
    mechanism = mechanism_of(crane, KitSettings())
    pose = apart(3)
    pose[:, 2, 0] = pose[:, 0, 0]  # joined to link 0
    pose[:, 5, 0] = pose[:, 3, 0]  # parts 2 and 3 collide on the bench too
    assert passing_contacts(crane, mechanism, Layers((True, False, False), ((), (), ())), pose, time_step=DT) == []
