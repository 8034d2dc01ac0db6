"""Sentences that follow from results files."""

import itertools
import json
import operator

import pytest

from benchmarks import sentences
from benchmarks.page_sentences import (
    CHOICES,
    DESK,
    LAPTOP,
    REPLICATES,
    ROW,
    SENSITIVITY,
    SENTENCES,
    SHALLOW,
    THROWS,
    TRACKS,
    VIDEO,
)
from benchmarks.sentences import ROOT, Sentence, complaints, with_figures, without_sentences


@pytest.fixture
def far(tmp_path, monkeypatch):
    """A sentence about a results file."""
    monkeypatch.setattr(sentences, "ROOT", tmp_path)
    (tmp_path / "far.json").write_text(json.dumps({"metres": -3.25, "share": 0.4}))
    return Sentence(
        "robots get {metres} m, {share} % of *E*, at every depth.",
        ("far.json",),
        lambda far: {"metres": f"{far['metres']:.1f}".replace("-", "−"), "share": f"{100 * far['share']:.0f}"},
        lambda far: far["share"] < 0.5,
    )


def test_figures_are_written_and_lines_stay(far):
    page = "Before. So robots\nget 17.9 ± 2.3 m, 1,234 % of\n*E*, at every depth. After 5 m."
    assert with_figures(page, [far]) == "Before. So robots\nget −3.2 m, 40 % of\n*E*, at every depth. After 5 m."
    assert complaints(page, [far]) == [] and without_sentences(page, [far]) == "Before. So  After 5 m."


@pytest.mark.parametrize(
    ("page", "n"), [("robots get far.", 0), ("robots get 1 m, 2 % of *E*, at every depth.\n" * 2, 2)]
)
def test_words_that_a_page_lacks_are_complained_of(far, page, n):
    (complaint,) = complaints(page, [far])
    assert complaint == (
        f'"robots get {{metres}} m, {{share}} % of *E*, at every depth." occurs {n} times, expected 1. Write on the '
        "page what far.json shows, and let the sentence in benchmarks/page_sentences.py agree."
    )


def test_words_that_the_results_do_not_bear_out_are_complained_of(far, tmp_path):
    (tmp_path / "far.json").write_text(json.dumps({"metres": -3.25, "share": 0.6}))
    (complaint,) = complaints("robots get 1 m, 2 % of *E*, at every depth.", [far])
    assert "no longer follows from the results" in complaint


def claim(page, words, study):
    (found,) = (of for of in SENTENCES[page] if words in of.words and of.of[0] == study)
    return found


@pytest.mark.parametrize(
    ("page", "words", "study", "arm", "quantity", "mean"),
    [
        ("README.md", "At all ten depths", DESK, ("designed_throws", 2.0), "zero_shot", 10.0),
        ("docs/results.md", "as far as its μ − σ", ROW, ("residual_slush", 9.0), "zero_shot", 10.0),
        ("docs/results.md", "At every depth", DESK, ("residual_slush", 3.5), "zero_shot", 19.0),
        ("docs/results.md", "as its μ − σ. At 0.5 m", SHALLOW, ("residual_slush", 3.0), "zero_shot", 10.0),
        ("docs/results.md", "In slush the order", LAPTOP, ("residual_slush", 2.0), "zero_shot", 19.0),
        ("docs/results.md", "In slush the order", LAPTOP, ("dry_land", 0.5), "zero_shot", 30.0),
        ("docs/results.md", "predict what robots do", LAPTOP, ("designed_throws", 9.0), "predicted", 15.0),
        ("docs/throws.md", "as far as the ensemble predicts", LAPTOP, ("single_member", 9.0), "zero_shot", 3.0),
        ("docs/throws.md", "observe magnitudes", LAPTOP, ("residual_slush", 9.0), "zero_shot", 9.0),
    ],
)
def test_a_claim_about_arms_needs_its_results(page, words, study, arm, quantity, mean):
    sentence = claim(page, words, study)
    first, *others = sentence.results
    other = json.loads(json.dumps(first))
    (changed,) = (of for of in other["arms"] if (of["environment"], of["depth"]) == arm)
    changed[quantity]["mean"] = mean
    assert sentence.holds(first, *others) and not sentence.holds(other, *others)


@pytest.mark.parametrize("study", [CHOICES, REPLICATES, SENSITIVITY, THROWS, TRACKS, VIDEO])
def test_other_claims_need_their_results(study):
    """They fail if every measurement is 1.3 times as large as the one before it."""
    for sentence in (of for known in SENTENCES.values() for of in known if of.of == (study,)):
        assert sentence.holds(*sentence.results)
        if sentence.holds is not sentences._is_true:
            growing = itertools.accumulate(itertools.repeat(1.3), operator.mul)
            assert not sentence.holds(upset(sentence.results[0], growing))


def upset(value, numbers):
    """Replace measurements, which are the decimal fractions, by other numbers."""
    if isinstance(value, dict):
        return {name: upset(inner, numbers) if name not in SAME else inner for name, inner in value.items()}
    if isinstance(value, list):
        return [upset(inner, numbers) for inner in value]
    return next(numbers) if isinstance(value, float) else value


SAME = {"rate", "noise_mm", "noise_deg", "band", "setting", "depth"}
"""Conditions of measurements."""


def test_pages_exist():
    assert [page for page in SENTENCES if not (ROOT / page).exists()] == []
