"""Settings files and --set: values arrive as written, and every mistake is one line that names the setting."""

import re
from pathlib import Path
from typing import Any, Literal, Self

import hypothesis.strategies as st
import pytest
import yaml
from hypothesis import given, settings
from pydantic import Field, model_validator

from pipeline.config import loading
from pipeline.config.loading import load, parse, preset_names, preset_path
from pipeline.errors import PuddleError
from tasks.parameters import Parameters


class Slush(Parameters):
    density: float = Field(default=1000.0, gt=0.0, le=2000.0)


class Grid(Parameters):
    depths: tuple[float, ...] = Field(default=(0.0, 9.0), min_length=1)
    environments: tuple[Literal["dry_land", "true_slush"], ...] = ("dry_land",)
    n_trials: int = Field(default=10, ge=1)
    media: tuple[Slush, ...] = ()
    by_name: dict[str, Slush] = Field(default_factory=dict)


class Study(Parameters):
    name: str = Field(default="paper", pattern="^[a-z]+$")
    note: str = ""
    seed: int = Field(default=1, ge=0, lt=2**63)
    resume: bool = True
    batch: int | None = None
    grid: Grid = Grid()
    slush: Slush | None = None

    @model_validator(mode="after")
    def _agree(self) -> Self:
        if self.seed == 13:
            raise ValueError("seed is 13, expected a luckier one")
        return self


def read(text: str, *overrides: str) -> Study:
    return parse(Study, text, name="lab.yaml", overrides=overrides)


def refused(text: str, *overrides: str) -> list[str]:
    with pytest.raises(PuddleError) as told:
        read(text, *overrides)
    return str(told.value).splitlines()


# -- values ---------------------------------------------------------------------------------------------------------


def test_a_file_changes_only_the_settings_that_it_names() -> None:
    study = read("grid:\n  depths: [0, 0.5, 1e-3, 5E0]\n  environments:\n  - true_slush\nseed: 5\n")
    assert study == Study(seed=5, grid=Grid(depths=(0.0, 0.5, 0.001, 5.0), environments=("true_slush",)))


@pytest.mark.parametrize("text", ["", "# nothing\n", "---\n", "{}", "\ufeffseed: 1"])
def test_an_empty_file_is_the_defaults(text: str, tmp_path: Path) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(text, encoding="utf-8")
    assert load(Study, path) == Study()


@pytest.mark.parametrize(
    ("word", "number"),
    [("1e-3", 0.001), ("1E3", 1000.0), (".5", 0.5), ("5.", 5.0), (".5e1", 5.0), ("08", 8.0), ("010", 10.0)],
)
def test_numbers_are_those_of_yaml_1_2(word: str, number: float) -> None:
    density = read(f"slush: {{density: {word}}}").slush.density
    assert density == number and type(density) is float


@pytest.mark.parametrize(
    ("word", "number"), [("5e4", 50_000), ("9223372036854775807", 2**63 - 1), ("050", 50), ("+07", 7)]
)
def test_a_whole_number_may_be_written_with_an_exponent_or_zeros_before_it(word: str, number: int) -> None:
    seed = read(f"seed: {word}").seed
    assert seed == number and type(seed) is int


@pytest.mark.parametrize("word", ["1:30", "yes", "true", "on", "0b11", "0o17", "0x1f", "2026-11-28"])
def test_what_is_no_number_in_yaml_1_2_is_refused_as_one(word: str) -> None:
    said = refused(f"grid: {{n_trials: {word}, depths: [{word}]}}")
    assert [line.partition(", ")[2] for line in said] == [
        f'unable to parse string as {kind}, got "{word}"' for kind in ("a number", "an integer")
    ]


@pytest.mark.parametrize(("word", "flag"), [("true", True), ("False", False), ("yes", True), ("off", False)])
def test_flags(word: str, flag: bool) -> None:
    assert read(f"resume: {word}").resume is flag


SETTINGS = st.fixed_dictionaries(
    {},
    optional={
        "seed": st.integers(0, 2**63 - 1).filter(lambda seed: seed != 13),
        "name": st.text("abcxyz", min_size=1),
        "note": st.sampled_from(("08", "0o17", "1:30", "true", "null", "2026-11-28", "2026", ".5", "", "<<")),
        "resume": st.booleans(),
        "batch": st.none() | st.integers(),
        "grid": st.fixed_dictionaries(
            {}, optional={"depths": st.lists(st.floats(0, 100), min_size=1), "n_trials": st.integers(1, 99)}
        ),
    },
)


@given(SETTINGS)
def test_what_yaml_writes_loads_as_the_same_settings(chosen: dict[str, Any]) -> None:
    assert read(yaml.safe_dump(chosen)) == Study.model_validate(chosen)


# -- overrides -------------------------------------------------------------------------------------------------------


def test_overrides_win_over_the_file_and_later_ones_over_earlier() -> None:
    overrides = ("seed=3", "grid.depths=[1, 2e0]", "name=abc", "seed=4", "resume=false", "batch=null")
    study = read("seed: 2\ngrid: {n_trials: 3}", *overrides)
    assert study == Study(seed=4, name="abc", resume=False, grid=Grid(depths=(1.0, 2.0), n_trials=3))
    assert read("", "grid={n_trials: 4}", "grid.environments=[true_slush]").grid == Grid(
        n_trials=4, environments=("true_slush",)
    )
    assert read("", "grid.by_name.oil.density=900").grid.by_name == {"oil": Slush(density=900.0)}
    assert read("", "name='a'").name == "a"


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("grid.n_trials=[ten]", 'grid.n_trials: expected a valid integer, got ["ten"]'),
        ("grid.depths=[1, []]", "grid.depths[1]: expected a valid number, got []"),
        ("grid.depths=", "grid.depths: expected a valid array, got null"),
        ("grid=3", "grid: expected an object, got 3"),
        ("seed", "expected a setting's name, = and its value, such as grid.n_trials=3"),
        ("grid..n_trials=3", "expected a setting's name, = and its value, such as grid.n_trials=3"),
        ("name=a: b", "expected a value, a list [..] or a group {..}, got a colon (quote it)"),
        ("grid.depths=[1", "while parsing a flow sequence, expected ',' or ']', but got '<stream end>'"),
        ("grid={n_trials: 1, n_trials: 2}", "'n_trials' appears twice"),
        ("seed.x=3", "seed: expected a group of settings, got 1"),
    ],
)
def test_a_mistake_in_an_override_names_the_override(override: str, message: str) -> None:
    assert refused("seed: 1\n", override) == [f"--set {override}: {message}"]


def test_contradictory_values_are_located_at_the_file_and_the_overrides() -> None:
    said = "seed is 13, expected a luckier one"
    assert refused("name: a\nseed: 13\n") == [f"lab.yaml: {said}"]
    twice = "grid.depths=[2, 3]", "seed=13"
    assert refused("grid: {n_trials: 3}\n", *twice) == [f"lab.yaml with --set {twice[0]} with --set {twice[1]}: {said}"]


# -- mistakes --------------------------------------------------------------------------------------------------------


def test_all_mistakes_are_reported() -> None:
    text = """
seed: -1
grid:
  depths: [0.5, {}, null]
  environments: [dry_land, moon]
  media: [{density: 1}, {density: 0}]
  n_trails: 3
  batches: 3
batch: {}
slush: [1]
nmae: x
"""
    assert sorted(refused(text)) == [
        "lab.yaml: batch: expected a valid integer, got {}",
        "lab.yaml: grid.batches: unknown setting",
        "lab.yaml: grid.depths[1]: expected a valid number, got {}",
        "lab.yaml: grid.depths[2]: expected a valid number, got null",
        "lab.yaml: grid.environments[1]: expected 'dry_land' or 'true_slush', got \"moon\"",
        "lab.yaml: grid.media[1].density: expected greater than 0, got 0",
        "lab.yaml: grid.n_trails: unknown setting; did you mean grid.n_trials?",
        "lab.yaml: nmae: unknown setting; did you mean name?",
        "lab.yaml: seed: expected greater than or equal to 0, got -1",
        "lab.yaml: slush: expected an object, got [1]",
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\nb:\n  c: 1\n  c: 2\n", ":3: 'c' appears twice"),
        ("seed: 1\n---\nseed: 2\n", ":2: expected a single document in the stream, but found another document"),
        ("- 1\n", ": expected settings like `name: value`, got [1]"),
        ("seed: 1\n? [1]\n: 2\n", ":2: while constructing a mapping, found unhashable key"),
        ("slush: {density: .nan}", ": slush.density: expected a finite number, got NaN"),
        ("seed: ten", ': seed: expected a valid integer, unable to parse string as an integer, got "ten"'),
        ("seed: 1.5", ": seed: expected a valid integer, got a number with a fractional part, got 1.5"),
        (f"seed: {2**63}", f": seed: expected less than {2**63}, got {2**63}"),
        ("grid:\n", ": grid: expected an object, got null"),
        ("grid: &a [*a]", ": expected lists and groups of plain values"),
    ],
)
def test_bad_yaml_is_refused(text: str, message: str) -> None:
    assert refused(text) == [f"lab.yaml{message}"]


@settings(max_examples=200)
@given(st.text(max_size=60) | st.text("ab:[]{}-,&*!|>'\"%@`#?\n\t 01e.~<", max_size=60))
def test_any_text_is_loaded_or_refused_in_lines(text: str) -> None:
    try:
        study = read(text)
    except PuddleError as error:
        assert all(line.startswith("lab.yaml") for line in str(error).split("\n"))  # not splitlines: text is free
    else:
        assert study == Study()


# -- files and presets -----------------------------------------------------------------------------------------------


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    path = tmp_path / "lab.yaml"

    def refusal(of: Path = path) -> str:
        with pytest.raises(PuddleError) as told:
            load(Study, of)
        return str(told.value)

    assert refusal().startswith(f"{path}: expected a settings file, got: No such file")
    assert refusal(tmp_path).startswith(f"{tmp_path}: expected a settings file, got: Is a directory")
    path.write_bytes(b"seed: 1\nname: \xff\n")
    assert refusal().startswith(f"{path}: ") and "invalid start byte" in refusal()


def test_presets_are_the_yaml_files_of_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert {"smoke", "laptop", "row-small", "row", "desk", "paper", "pontoon", "tank"} <= set(preset_names())
    monkeypatch.setattr(loading, "PRESETS", tmp_path)
    for name in ("smoke.yaml", "laptop.yaml", "notes.txt"):
        (tmp_path / name).touch()
    assert preset_names() == ["laptop", "smoke"]
    assert preset_path("smoke") == tmp_path / "smoke.yaml"
    for name in ("smok", "../smoke", "smoke.yaml", "", "/etc/passwd", "*"):
        with pytest.raises(PuddleError, match=f"preset {re.escape(repr(name))}: expected one of laptop, smoke"):
            preset_path(name)
