"""Every figure in the running text of README.md and docs is that of a results file, or one of a short list."""

import re

import pytest

from benchmarks import published
from benchmarks.sentences import Sentence, without_sentences

NUMBER = r"[−-]?\d(?:[\d,.]*\d)?"
UNIT = r"(?:%|(?:m|cm|mm)(?:/s)?(?![\w²³·/])|rad/s)"
FIGURE = "|".join(
    (
        rf"(?:{NUMBER}(?:\s*{UNIT})?(?:\s+(?:to|and|of|or|±|×)|,)\s+)*{NUMBER}\s*{UNIT}",
        rf"±\s*{NUMBER}",
        rf"\bp\s*[=<>]\s*{NUMBER}",
        rf"\b(?:R|[Ss]lopes?)\s+(?:of\s+|=\s*)?{NUMBER}",
        r"\b\d+\s+of\s+(?:the\s+)?\d+\b(?!\s+×)",
        r"\b[01]\.\d\d\b(?!\s*(?:kg|s\b))",
        r"\b1/\d(?:[\d,]*\d)?\b(?!\s*s\b)",
    )
)
"""Displacements, shares, deviations, p-values, correlations, counts and ratios; not times, sizes and torques."""

HELD_ELSEWHERE = r"<!-- from benchmarks/results\.json.*?<!-- end -->|^```.*?^```$|`[^`]*`|\]\([^)]*\)"
"""Benchmarks, which have a test of their own; code, which tests run; links."""

WRITTEN_AS_A_WHOLE = {"docs/sensitivity.md"}  # from its results file, which a test compares

EXCEPTIONS = {
    "the depth of the ground": (
        *("at 9 m", "in 9 m of", "At 9 m:", "| 9 m at", "9 m below", "in 2 m of", "At 2 m, over", ": 2 m of slush"),
        *("3 trials each at 0.5, 1 and 3 m", "tank/residual_slush/2m"),
    ),
    "the paper's own numbers": (
        *("and 13.6 m in the paper", "would give 13.6 m too", "recover 67 % of the displacement of *E*"),
        *("throws at up to 28 m/s and 20 rad/s", "The paper's robot crossed 8 of 8 times"),
        *("1.17 × 0.33 × 0.27 m", "1.17 m × 0.33 m × 0.27 m, filled 0.15 m deep"),
    ),
    "settings, and what follows from them by arithmetic": (
        *("networks of a twentieth of the weights and about 1/2,400 of the training", "any length from 1 to 3 m"),
        *("1/67 of the paper's weights and less than 1/10,000 of its training", "genes allow, 1 to 3 m"),
        *(
            "**Heights** are within ± 3 m of the surface",
            "half its length, at most 1.5 m",
            "20 % of the paper's *E* for displacements, 15 points for shares, 0.15 for R and 0.25 for slopes",
            "links reach 210 mm to either side",
            "Every robot is 325 mm wide",
        ),
        *(
            "70 mm per metre",
            "140 mm of water",
            "70 to 210 mm long, and 70 mm × 70 mm divided by its length",
            "scale by √0.07",
        ),
        *("80 % of the fluid that they displace", "1 m/s is 0.26 m/s on the bench", "20 kg·cm are 1.96 N·m"),
        *("standard deviation of 2 m, a mean is known to about ± 2.3 m", "jumps above 16 m/s"),
        *("Dropout (0.1 % in the paper) and weight decay (0.01, torch's default)", "weight decay 0.01"),
        *("a warm-up of 0.01 of the iterations", "no motor drives its joint faster than 1 rad/s"),
        *("a DS3225 servo reaches 1.85 unloaded at this scale, and 1.5 while it gives",),
    ),
    "the ranges of designed throws, which tests/tasks/residual/test_robot_ranges.py compares with the page": (
        "99.9 % of their states are slower than 4.8 m/s and 6.1 rad/s",
    ),
    "how a measurement was made": (
        *("1.8 m before a tank of 1.1 × 0.62 m", "bars 3 mm behind the tank's tags; 2 % of the frames dropped"),
        *("with 0.1 mm and 0.2° of noise", "(designed throws at 0 m, trial 3; the paper's throws at 3.5 m, trial 0)"),
    ),
    "how to read a table": ("95 % interval", "a share of *E* above 100 % is possible", "Noise decides below 0.1 m/s"),
    "what is aimed at, or tested": (
        "an error of less than 100 mm goes unnoticed",
        "5 % without noise and 20 % from video",
        "every core at least 85 % busy",
        "The aim for *Ê\\** was 97 % of *E* zero-shot, and 97 % of *E* adapted after adaptation.",
    ),
    "parts, prints and pictures": (
        *("40.5 × 20 × 38 mm", "1 mm by default", "with 45 % infill", "300 mm apart", "a gap of 1 mm"),
        *("2.6 m of steel rod", "a picture 1.3 m wide"),
    ),
    "messages and examples": ("A 70 mm bar said to be 70 m", "the bar's length is 140 m"),
    "the cost of training": ("1.26 × 10¹⁷ floating-point operations",),
}
"""Words of the pages with figures that no results file holds, by why that is so."""


def excepted():
    return [Sentence(words, ()) for phrases in EXCEPTIONS.values() for words in phrases]


def running_text(page):
    name = page.relative_to(published.ROOT).as_posix()
    if name in WRITTEN_AS_A_WHOLE:
        return ""
    text = published.SECTION.sub("", page.read_text(encoding="utf-8"))
    text = without_sentences(text, published.SENTENCES.get(name, ()))
    return re.sub(HELD_ELSEWHERE, "", text, flags=re.M | re.S)


def unheld(text):
    text = without_sentences(text, excepted())
    return [" ".join(found.split()) for found in re.findall(FIGURE, text)]


@pytest.mark.parametrize("page", published.PAGES, ids=lambda page: page.name)
def test_figures_in_running_text_are_those_of_results_files(page):
    assert unheld(running_text(page)) == [], (
        "a new figure takes a sentence in benchmarks/page_sentences.py, or a reason among EXCEPTIONS"
    )


def test_exceptions_occur():
    whole = "\n".join(running_text(page) for page in published.PAGES)
    assert [of.words for of in excepted() if not of.pattern.search(whole)] == []


@pytest.mark.parametrize(
    "figure",
    [
        *(
            "12.5 m",
            "−0.3 m",
            "3 and 4 m",
            "11.0 ± 2.6 m",
            "40 %",
            "26 %, 109 %",
            "± 2.3",
            "47 mm/s",
            "25 cm",
            "5 rad/s",
        ),
        *("p = 0.0009", "p < 0.001", "R of 0.97", "R 0.97", "slope 1.2", "103 of 128", "10 of the 16", "1/140"),
    ],
)
def test_a_new_figure_is_found(figure):
    assert unheld(f"Robots get {figure}, which is new.") == [figure]


@pytest.mark.parametrize("words", ["at\n9 m", "20 s", "16 designs", "8 networks of 3 × 64", "Python 3.11", "1.9 GB"])
def test_depths_times_and_settings_are_none(words):
    assert unheld(f"Robots get far {words}.") == []
