"""The page of studies that went wrong as science: what can't be computed is left out, and the reason is there."""

from __future__ import annotations

import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from small_study import inputs_of, run

from pipeline.cluster import serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.report.study_page import FIGURES
from pipeline.stages import STAGES, environments
from pipeline.stages.report import PAGE, REPORT
from pipeline.store.store import Store
from tasks.world import ResidualSlush, Slush, TrueSlush


@pytest.fixture
def page_of(settings, tmp_path, all_figures):
    """Run the tiny study otherwise, and give its page."""

    def page(*overrides: str) -> str:
        changed = parse(Settings, settings.model_dump_json(), name="tiny", overrides=overrides)
        store = Store.open(tmp_path / "store", create=True)
        with serial_cluster() as cluster:
            upstream = run(changed, store, cluster, STAGES[:-1])
        assert not any(results.failed for results in upstream.values())
        chain = next(chain for chain in REPORT.plan(changed) if chain.label == PAGE)
        item = REPORT.item(changed, chain, 0, None, upstream)
        return REPORT.compute(item, inputs_of(store, item))[PAGE].decode()

    return page


def words_of(html: str) -> str:
    """What a reader reads; numbers that are none would stand there as nan or inf."""
    shown = re.sub(r"<script.*?</script>|<style.*?</style>", " ", html, flags=re.DOTALL)
    words = " ".join(unescape(re.sub(r"<[^>]+>", " ", shown)).split())
    assert not re.search(r"\b(nan|NaN|inf|None)\b", words)
    return words


def check_figures(html: str, *missing: str) -> None:
    """Every figure is there, but for some, and for those of several depths and of another search."""
    drawn = {name for name in FIGURES if f'<figure id="{name}">' in html}
    assert drawn == FIGURES.keys() - {"transfer_across_depths", "elites", *missing}


def test_a_single_trial_has_no_intervals_and_no_tests(page_of):
    html = page_of("grid.n_trials=1")
    check_figures(html)
    assert " ± " in words_of(html)


def test_where_nothing_moves_there_is_nothing_to_compare(page_of):
    """No gravity, no buoyancy and no torque: what is left is the rounding of joints, 1e-8 m."""
    html = page_of("physics.gravity=0", "physics.max_motor_torque=0")
    check_figures(html)
    assert not re.search(r"\b1e−\d", words_of(html))  # no figure blows the rounding up


def test_where_every_design_diverges_each_thing_says_so(page_of, monkeypatch):
    """A drag that is no number, and networks that push beyond every number; nothing else is different."""
    real = environments.build_environment
    drag = Slush.model_construct(**{**Slush().model_dump(), "linear_drag": np.nan})

    def wild(media, name, depth, inputs):
        environment = real(media, name, depth, inputs)
        if depth == 0.0 and name == "true_slush":  # what the networks learn from is sound
            return environment
        if not isinstance(environment, ResidualSlush):
            return TrueSlush(depth=environment.depth, slush=drag)
        *biases, last = environment.ensemble.biases
        return replace(environment, ensemble=replace(environment.ensemble, biases=(*biases, np.full_like(last, 3e38))))

    monkeypatch.setattr(environments, "build_environment", wild)
    html = page_of("grid.n_trials=1")
    check_figures(html, "transfer_at_depth", "fitness_curves", "prediction_accuracy")
    words = words_of(html)
    assert "There is no champion: every design of every trial diverged." in words
    for arm in ("true_slush", "dry_land", "residual_slush", "single_member"):
        assert words.count(f"{arm}/1m/trial-0: no champion: every design of the trial diverged") == 1
    for arm, n_assessed in (("true_slush", 10), ("dry_land", 11)):
        said = f"{n_assessed} of {n_assessed} designs diverged, in the target or under a member"
        assert f"assess: residual_slush/{arm}/1m/trial-0: {said}" in words
    assert not re.search(r"transfer: \w+/", words)
