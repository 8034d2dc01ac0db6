"""Settings written out: each has its reason, and the text loads as the same settings."""

import json

import jsonschema
import pytest
import yaml
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
    assert "name: mine  # default: paper" in lines
    text = " ".join(line.strip().lstrip("# ") for line in lines)  # the list may be wrapped
    assert "One of: uniform, log_uniform." in text
    assert all(len(line) <= 120 for line in lines)


def test_the_command_lists_the_chosen_settings(capsys):
    assert call("settings", "--preset", "smoke", "--set", "seed=7") == 0
    assert "seed: 7  # default: 1" in capsys.readouterr().out


def test_the_schema_accepts_the_presets_and_refuses_what_loading_refuses(capsys):
    assert call("settings", "--schema") == 0
    schema = json.loads(capsys.readouterr().out)
    check = jsonschema.Draft202012Validator(schema)
    check.check_schema(schema)
    for name in preset_names():
        check.validate(load(Settings, preset_path(name)).model_dump(mode="json"))
        check.validate(yaml.safe_load(preset_path(name).read_text().replace("1e-2", "0.01")))  # as an editor reads it
    for wrong in ({"wobble": 3}, {"seed": "many"}, {"grid": {"depths": [-1.0]}}, {"work": {"engine": "warp"}}):
        assert list(check.iter_errors(wrong)), wrong
    assert "Depths of the ground below the surface [m]. [P]" in json.dumps(schema, ensure_ascii=False)
