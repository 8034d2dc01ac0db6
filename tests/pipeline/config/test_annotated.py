"""Settings written out: each has its reason, and the text loads as the same settings."""

import pytest
from command_line import call

from pipeline.config.annotated import annotated_lines
from pipeline.config.loading import load, parse, preset_names, preset_path
from pipeline.config.settings import Settings


@pytest.mark.parametrize("name", preset_names())
def test_the_text_loads_as_the_same_settings(name):
    settings = load(Settings, preset_path(name))
    assert parse(Settings, "\n".join(annotated_lines(settings)), name=name) == settings


def test_a_setting_without_a_default_is_written():
    """The file of tracked throws is one."""
    settings = Settings(tracks={"file": "throws.csv"}, throws={"source": "tracks"})
    assert parse(Settings, "\n".join(annotated_lines(settings)), name="paper") == settings


def test_names_that_look_like_other_types_are_quoted():
    for name in ("true", "null", "1e3", "9", "a-b_c", "no"):
        settings = Settings(name=name)
        assert parse(Settings, "\n".join(annotated_lines(settings)), name=name) == settings


def test_a_setting_has_its_reason_above_and_its_default_beside_it():
    lines = annotated_lines(Settings(name="mine"))
    for number, line in enumerate(lines):
        if ":" in line and not line.lstrip().startswith("#"):
            assert lines[number - 1].lstrip().startswith("# "), line
    assert 'name: "mine"  # default: "paper"' in lines
    assert "One of: exponential, cosine." in " ".join(line.strip().lstrip("# ") for line in lines)  # it is wrapped


def test_the_command_lists_the_chosen_settings(capsys):
    assert call("settings", "--preset", "smoke", "--set", "seed=7") == 0
    assert "seed: 7  # default: 1" in capsys.readouterr().out
