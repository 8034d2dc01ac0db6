"""The time that a study is expected to take, before anything of it has been measured."""

import pytest

from pipeline.commands.expected_time import expected_seconds
from pipeline.config.loading import load, preset_names, preset_path
from pipeline.config.settings import Settings
from pipeline.stages import STAGES


@pytest.mark.parametrize("name", preset_names())
def test_every_stage_has_a_time_that_cores_shorten(name):
    settings = load(Settings, preset_path(name))
    one, many = expected_seconds(settings, 1.0), expected_seconds(settings, 64.0)
    assert list(one) == [stage.name for stage in STAGES]
    assert all(0 <= many[stage] <= one[stage] for stage in one) and one["evolve"] > many["evolve"]


@pytest.mark.parametrize(("name", "least", "most"), [("smoke", 10, 120), ("laptop", 600, 2400), ("row", 3600, 9000)])
def test_the_time_of_a_preset_is_that_of_the_readme(name, least, most):
    """A minute, 20 to 40 minutes and two hours on two cores, within the factor of two that is promised."""
    assert least <= sum(expected_seconds(load(Settings, preset_path(name)), 2.0).values()) <= most
