"""The time that a study is expected to take, before anything of it has been measured."""

import pytest

from pipeline.commands import expected_time
from pipeline.commands.expected_time import expected_seconds
from pipeline.config.loading import load, preset_names, preset_path
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from tasks.simulation import batch
from tasks.world import Physics


@pytest.mark.parametrize("name", preset_names())
def test_every_stage_has_a_time_that_cores_shorten(name):
    settings = load(Settings, preset_path(name))
    one, many = expected_seconds(settings, 1.0), expected_seconds(settings, 64.0)
    assert list(one) == [stage.name for stage in STAGES]
    assert all(0 <= many[stage] <= one[stage] for stage in one) and one["evolve"] > many["evolve"]


@pytest.mark.parametrize(("name", "least", "most"), [("smoke", 10, 120), ("laptop", 600, 2400), ("row", 5400, 21600)])
def test_the_time_of_a_preset_is_that_of_the_readme(name, least, most):
    """A minute, half an hour and three hours on two cores, within the factor of two that is stated."""
    assert least <= sum(expected_seconds(load(Settings, preset_path(name)), 2.0).values()) <= most


def test_kernels_that_are_not_compiled_yet_take_time(monkeypatch):
    settings = load(Settings, preset_path("smoke"))
    monkeypatch.setattr(expected_time, "seconds_to_compile", lambda physics: 0.0)
    compiled = expected_seconds(settings, 2.0)
    monkeypatch.setattr(expected_time, "seconds_to_compile", lambda physics: 50.0)
    assert expected_seconds(settings, 2.0) == compiled | {"evolve": compiled["evolve"] + 50.0}


def test_only_the_kernels_of_the_engine_in_use_are_waited_for(monkeypatch):
    left = {"tasks.simulation.rigid_bodies.step.advance_robots": 30, "tasks.simulation.trees.step.advance": 20}
    monkeypatch.setattr(batch, "uncompiled_kernels", lambda: left | {"tasks.design.genes.find_fault": 1})
    assert batch.seconds_to_compile(Physics()) == 21
    assert batch.seconds_to_compile(Physics(link_collisions=True)) == 31
