"""Settings written out: each has its reason, and the text loads as the same settings."""

import pytest

from pipeline.config.annotated import annotated_lines
from pipeline.config.loading import load, parse, preset_names, preset_path
from pipeline.config.settings import Settings


@pytest.mark.parametrize("name", preset_names())
def test_the_text_loads_as_the_same_settings(name):
    settings = load(Settings, preset_path(name))
    assert settings.name == name
    assert parse(Settings, "\n".join(annotated_lines(settings)), name=name) == settings


def test_odd_names_and_a_setting_without_a_default_load_as_the_same_settings():
    odd = [Settings(name=name) for name in ("true", "null", "1e3", "9", "a-b_c", "no")]
    for settings in (*odd, Settings(tracks={"file": "throws.csv"}, throws={"source": "tracks"})):
        assert parse(Settings, "\n".join(annotated_lines(settings)), name="mine") == settings


def test_a_setting_has_its_reason_above_and_its_default_beside_it():
    lines = annotated_lines(Settings(name="mine"))
    for number, line in enumerate(lines):
        if ":" in line and not line.lstrip().startswith("#"):
            assert lines[number - 1].lstrip().startswith("# "), line
    assert 'name: "mine"  # default: "paper"' in lines
    assert "One of: exponential, cosine." in " ".join(line.strip().lstrip("# ") for line in lines)  # it is wrapped
