"""The page of studies that went wrong as science: what can't be computed says why in its place, the rest is there."""

from __future__ import annotations

import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from small_study import run

from pipeline.cluster import serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.report.figures import FIGURES
from pipeline.stages import STAGES, environments, train
from pipeline.stages.report import PAGE, REPORT
from pipeline.store.encoding import encode_arrays
from pipeline.store.store import Store
from tasks.world import ResidualSlush, Slush, TrueSlush

TITLES = {name: title for name, (title, _) in FIGURES.items() if not name.endswith("_wide")}


@pytest.fixture
def page_of(settings, tmp_path):
    """Run the tiny study otherwise, and give its page without the films."""

    def page(*overrides: str, all_done: bool = True) -> str:
        changed = parse(Settings, settings.model_dump_json(), name="tiny", overrides=overrides)
        store = Store.open(tmp_path / "store", create=True)
        with serial_cluster() as cluster:
            upstream = run(changed, store, cluster, STAGES[:-1])
        assert all_done == (not any(results.failed for results in upstream.values()))
        chain = next(chain for chain in REPORT.plan(changed) if chain.label == PAGE)
        item = REPORT.item(changed, chain, 0, None, upstream)
        inputs = {name: {f: store.read(of.manifest, f) for f in of.files} for name, of in item.inputs.items()}
        return REPORT.compute(item.job, inputs)[PAGE].decode()

    return page


def words_of(html: str) -> str:
    """What a reader reads; numbers that are none would stand there as nan or inf."""
    shown = re.sub(r"<script.*?</script>|<style.*?</style>", " ", html, flags=re.DOTALL)
    words = " ".join(unescape(re.sub(r"<[^>]+>", " ", shown)).split())
    assert not re.search(r"\b(nan|NaN|inf|None)\b", words)
    return words


def absent(html: str) -> dict[str, str]:
    """Title -> reason, of everything that the page has to do without."""
    found = re.findall(r'<p class="absent"><b>(.*?)</b>: not available, because (.*?)\.</p>', html)
    return {unescape(title): unescape(reason) for title, reason in found}


def check_figures(html: str, missing: dict[str, str]) -> None:
    """Every figure is there, or its reason is."""
    assert absent(html) == missing
    drawn = {title for name, title in TITLES.items() if f'<figure id="{name}">' in html}
    of_several_depths = {"Transfer across depths", "Transfer between depths"}  # left out: there is one depth
    assert drawn == set(TITLES.values()) - set(missing) - of_several_depths


def test_a_single_trial_has_no_intervals_and_no_tests(page_of):
    html = page_of("grid.n_trials=1")
    check_figures(html, {})
    words = words_of(html)
    assert "1 and 1 values, expected 2 or more in both groups" in words
    assert "1 value, an interval needs 3 or more" in words


def test_where_nothing_moves_there_is_nothing_to_compare(page_of):
    """No gravity, no buoyancy and no torque: what is left is the rounding of joints, 1e-8 m."""
    html = page_of("physics.gravity=0", "physics.max_motor_torque=0")
    check_figures(html, {"Accuracy of members and aggregates": "every design truly goes equally far"})
    words = words_of(html)
    assert "both groups are constant" in words
    assert "the reference goes nowhere, or backwards" in words
    assert not re.search(r"\b1e−\d", words)  # no figure blows the rounding up


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
    everyone = "every design of every trial diverged"
    no_champion = "no trial of this arm has a champion"
    missing = absent(html)
    tests = missing.pop("The table of tests")
    assert tests.startswith("no depth has scores of both sides: Dry Land zero-shot against True Slush")
    assert missing == {
        "The gallery": everyone,
        "Transfer at the greatest depth": everyone,
        "Fitness by generation": everyone,
        "Transfer gap: body and controller": (
            "0 trials scored zero-shot and adapted and 0 in True Slush, expected 1 or more"
        ),
        "Family tree of a champion": "every design of the trial diverged",
        "Prediction accuracy": "every assessed design diverged, in True Slush or under a member",
        "Accuracy of members and aggregates": "every assessed design diverged, in True Slush or under a member",
        "Error of the members on champions": no_champion,
        "Champions outside the throws": no_champion,
        "The table of luck and reach": no_champion,
    }
    words = words_of(html)
    assert f"There is no champion: {everyone}." in words
    for arm in ("true_slush", "dry_land", "residual_slush", "single_member"):
        assert words.count(f"{arm}/1m/trial-0: no champion: every design of the trial diverged") == 1
    for arm, n_assessed in (("true_slush", 10), ("dry_land", 11)):
        said = f"{n_assessed} of {n_assessed} designs diverged, in True Slush or under a member"
        assert f"assess: {arm}/1m/trial-0: {said}" in words
    assert not re.search(r"transfer: \w+/", words)
    assert {f'<figure id="{name}">' in html for name in ("data_set", "residual_error", "phantom_thrust")} == {True}


def test_members_that_observe_different_things_are_named_and_the_rest_is_there(page_of, monkeypatch):
    """The second member was made by a code that observed five things of a link."""

    def older(arrays, **said):
        if said["producer"] != first.setdefault("key", said["producer"]):
            arrays = {**arrays, "observation_mean": arrays["observation_mean"][:5]}
        return encode_arrays(arrays, **said)

    first: dict[str, str] = {}
    monkeypatch.setattr(train, "encode_arrays", older)
    html = page_of("grid.n_trials=1", all_done=False)
    fault = "WeightsError: member 1: observation_mean has shape (5,), expected (6,)"
    missing = absent(html)
    assert (
        missing["Prediction accuracy"].count(fault) == missing["Accuracy of members and aggregates"].count(fault) == 2
    )
    assert f"residual_slush/1m/trial-0 failed after 2 attempts at residual_slush/1m/trial-0/segment-0: {fault}" in (
        words_of(html)
    )
    assert {f'<figure id="{name}">' in html for name in ("data_set", "fitness_curves", "transfer_at_depth")} == {True}
