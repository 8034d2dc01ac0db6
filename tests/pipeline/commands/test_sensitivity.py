"""`puddle sensitivity`: studies of variants, the table, the page, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import call, refused
from scipy.stats import norm

from pipeline.commands.sensitivity import plan_of
from pipeline.config.loading import load, preset_path
from pipeline.config.open_choices import OPEN_CHOICES
from pipeline.config.settings import Settings
from pipeline.report.sensitivity_page import FIRST_LINE, SENSITIVITY, sensitivity_page, verdict_words
from pipeline.results.recorded_study import open_study
from tasks.analysis.comparison import difference, student
from tasks.analysis.variant_effects import effects

SETTINGS = """name: tiny
grid: {depths: [1.0, 9.0], environments: [true_slush], single_member_depths: [], n_trials: 2}
rollout: {n_settle: 5, n_measure: 20}
evolution: {n_generations: 2, afpo: {population_size: 4}}
transfer: {n_generations: 2}
work: {engine: reference}
"""

VARIANTS = ("redraw", "rate-per-individual")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("sensitivity")
    (folder / "tiny.yaml").write_text(SETTINGS)
    return folder


def arguments(folder: Path, *more: str) -> list[str]:
    where = ("--settings", str(folder / "tiny.yaml"), "--store", str(folder / "store"), "--workers", "0")
    chosen = [word for name in VARIANTS for word in ("--variant", name)]
    return ["sensitivity", *where, *chosen, "--max-trials", "3", *more]


@pytest.fixture(scope="module")
def page(folder) -> Path:
    out = folder / "sensitivity.md"
    assert call(*arguments(folder, "--out", str(out))) == 0
    return out


def test_every_variant_is_a_study_that_differs_in_one_setting(page, folder):
    base, redraw, rate = (open_study(f"tiny-{name}", folder / "store") for name in ("base", *VARIANTS))
    assert base.settings.grid.depths == (9.0,) and base.settings.grid.n_trials == 3
    assert redraw.settings.evolution.afpo.mutation.changed_genes == "redraw"
    assert redraw.settings.transfer.adapted_environments == () and "redraw" not in rate.settings.model_dump_json()
    assert rate.settings.transfer.mutation_rate == "per_individual"
    assert base.settings.transfer.adapted_environments == rate.settings.transfer.adapted_environments == ("true_slush",)


def test_the_numbers_are_those_of_the_champions(page, folder):
    found = SENSITIVITY.validate_json(page.with_suffix(".json").read_bytes())
    assert (found.n_pilot, found.n_trials, found.base_study) == (2, 3, "tiny-base")
    base = open_study("tiny-base", folder / "store").champions()
    for row, effect in found.effects():
        x, y = (np.array(table[row.score]) for table in (open_study(row.study, folder / "store").champions(), base))
        assert row.displacement == tuple(x.tolist()) and row.base == tuple(y.tolist())
        assert effect.difference == difference(x, y) and effect.student == student(x, y)
    assert len({found.base_digest, *(row.digest for row in found.rows)}) == 3


def test_the_page_is_that_of_its_result_and_can_be_made_again(page, folder, capsys):
    result, text = page.with_suffix(".json").read_bytes(), page.read_text()
    assert sensitivity_page(SENSITIVITY.validate_json(result)) == text and text.startswith(FIRST_LINE)
    shown = json.loads(result)["command"]
    assert shown.startswith("puddle sensitivity --settings") and shown.endswith("--max-trials 3")
    capsys.readouterr()
    assert call(*arguments(folder, "--out", str(page))) == 0
    said = capsys.readouterr()
    assert "starting the cluster" not in said.err  # everything is in the store
    assert max(map(len, said.out.splitlines()[:-1])) <= 80
    assert [line.split()[0] for line in said.out.splitlines() if line.startswith(VARIANTS)] == list(VARIANTS)
    assert page.read_text() == text


def test_all_variants_apply_to_the_preset_but_that_of_ensembles():
    plan = plan_of(load(Settings, preset_path("row-small")), ())
    assert len(plan.choices) == len(OPEN_CHOICES) - 1
    assert [line.split(":")[0] for line in plan.left_out] == ["sample-deviation"]
    for choice in plan.choices:
        variant, base = plan.study(choice, 8), plan.base
        assert variant != base and variant.evolution.n_generations == base.evolution.n_generations


def test_an_ensemble_is_an_arm_of_the_base_where_a_variant_concerns_it():
    settings = load(Settings, preset_path("laptop"))
    plan = plan_of(settings, ["sample-deviation"])
    assert plan.base.grid.environments == ("true_slush", "residual_slush") and plan.base.grid.depths == (9.0,)
    variant = plan.study(plan.choices[0], 10)
    assert variant.grid.environments == ("residual_slush",) and variant.ensemble.deviation == "sample"


# -- bad input -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--variant", "drag"], "--variant drag: expected one of joint-limits, peak-to-peak,"),
        (["--set", "grid.environments=[dry_land]"], "grid.environments: expected true_slush,"),
        (["--set", "grid.n_trials=1"], "grid.n_trials is 1: expected at least 2"),
        (["--variant", "sample-deviation"], "--variant sample-deviation: it concerns residual_slush"),
        (["--set", "evolution.afpo.mutation.changed_genes=redraw"], "--variant redraw: the settings have"),
        (
            [
                "--variant",
                "joint-limits",
                "--set",
                "physics.passive_joints=locked",
                "--set",
                "evolution.morphology.n_actuated=2",
            ],
            "joint_limits is range_of_motion and passive_joints is locked",
        ),
        (["--power", "1"], "--power: expected a probability between 0 and 1, got 1"),
        (["--set", f"name={'x' * 50}"], "name: expected"),
    ],
)
def test_what_cannot_be_run(folder, tmp_path, more, message, capsys):
    said = refused(
        capsys, *arguments(folder, "--store", str(tmp_path / "store"), *more, "--out", str(tmp_path / "s.md"))
    )
    assert message in said and len(said.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_a_page_that_cannot_be_written(folder, tmp_path, capsys):
    (tmp_path / "notes.md").write_text("what I found")
    (tmp_path / "folder.md").mkdir()
    for name, message in (
        ("page.html", "expected a file name that ends in .md, in an existing folder"),
        ("missing/page.md", "expected a file name that ends in .md, in an existing folder"),
        ("notes.md", "which is neither"),
        ("folder.md", "which is neither"),
        ("x" * 300 + ".md", "can't write"),
    ):
        said = refused(capsys, *arguments(folder, "--store", str(tmp_path / "store"), "--out", str(tmp_path / name)))
        assert message in said and len(said.splitlines()) == 1, name
    assert (tmp_path / "notes.md").read_text() == "what I found" and not (tmp_path / "store").exists()


def test_champions_that_do_not_move_have_no_deviation_to_plan_with(folder, tmp_path, capsys):
    still = ("--set", "physics.gravity=0", "--set", "physics.max_motor_torque=0", "--set", "rollout.n_measure=3")
    where = ("--store", str(tmp_path / "store"), "--out", str(tmp_path / "s.md"))
    assert call(*arguments(folder, *still, *where)) == 2
    said = capsys.readouterr().err
    assert "study tiny-pilot: expected champions of true_slush that travel" in said


@pytest.mark.parametrize(
    ("shift", "words"),
    [
        (0.0, "negligible"),
        (8.0, "matters"),
        (2.0, "a difference (more than 1,000 trials)"),
        (-1.5, "a difference (34 trials)"),
    ],
)
def test_a_planted_effect_has_its_verdict(shift, words):
    """The base travels 10 m with a deviation of 1 m over 16 trials, so ± 2 m is negligible."""
    normal = norm.ppf((np.arange(16) + 0.5) / 16)
    base = 10 + normal / normal.std(ddof=1)
    (effect,) = effects([(base + shift, base)])
    assert verdict_words(effect) == words
