from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace

import pytest

from pipeline.report.findings import Findings, TankRow
from pipeline.report.lineage import main_line
from pipeline.report.page_tables import against_paper, contrasts, exploiters, lineage, retried, tank_tests, typeset
from pipeline.report.transfer_table import variance_table
from pipeline.report.wording import interval, p_value
from tasks.analysis.tank import Crossing, Tank, TankTrials
from tasks.analysis.uncertainty import Estimate


def words(html: str) -> str:
    return " ".join(re.sub(r"<[^>]+>", " ", html).split())


def test_the_variance_between_replicates_has_a_table_where_there_are_several(findings, replicated):
    assert variance_table(findings) == ""
    text = words(variance_table(replicated))
    (row,) = (row for row in replicated.replicated if row.quantity == "zero_shot")
    share = row.share_between
    assert f"{row.sd_between:.1f} between, {row.sd_within:.1f} within" in text
    assert f"{100 * share.value:.0f} % between ({100 * share.low:.0f} % to {100 * share.high:.0f} %)" in text
    assert "Residual Slush, 9 m n = 6 in 2 replicates" in text and "True Slush, 9 m" not in text
    assert "can’t tell one from the other" in text


def test_the_clustered_test_is_shown_where_there_are_replicates(findings, replicated):
    assert "Clustered" not in contrasts(findings) and "clustered" not in contrasts(findings)
    (row,) = replicated.contrasts
    text = words(contrasts(replicated))
    assert f"Clustered {p_value(row.comparison.clustered.p)}, Holm {p_value(row.clustered_holm)}" in text
    assert "n = 6, 6 in 2, 1 replicates" in text and "The clustered test is Welch’s" in text
    assert "single replicate" in words(against_paper(replicated))
    assert "replicate" not in words(against_paper(findings))


@pytest.mark.parametrize(
    ("found", "shown"),
    [
        (Estimate(1.24, 0.96, 1.55), "1.2 1.0 to 1.6"),
        (Estimate(-0.04, -0.2, 0.04), "0.0 −0.2 to 0.0"),  # no negative zero
        (Estimate(3.0, reason="1 value"), "3.0 1 value"),
        (Estimate.missing("none & no more"), "– none &amp; no more"),
    ],
)
def test_an_estimate_shows_its_interval_or_why_it_has_none(found, shown):
    assert words(interval(found)) == shown


def test_p_values_have_two_digits_or_a_bound():
    assert [p_value(p) for p in (None, 0.0123, 1e-4, 9.9e-5)] == ["–", "0.012", "0.0001", "< 0.0001"]


def is_test(row) -> bool:
    return row.what.startswith("Student")


def test_every_number_of_the_paper_that_is_measured_is_listed_with_its_verdict(findings):
    text = words(against_paper(findings))
    numbers = [row for row in findings.against_paper if not is_test(row)]
    shown = [row for row in numbers if row.this_run != "-"]
    for row in numbers:
        typeset = row.what.replace("'", "’").replace(" - ", " − ")
        assert (typeset[:1].upper() + typeset[1:] in text) == (row in shown)
    counts = Counter(row.verdict for row in shown)
    assert len(counts) > 1
    for verdict, mark in (("agrees", "✓"), ("differs", "≠"), ("cannot tell", "?"), ("not comparable", "–")):
        assert text.count(f"{mark} {verdict}") == counts[verdict]
    assert f"{len(numbers) - len(shown)} numbers that this study does not measure are left out" in text


def test_a_study_without_the_papers_arms_and_depths_has_no_comparison(findings):
    """Not a table that says "not comparable" thirteen times."""
    rows = [replace(row, verdict="not comparable", this_run="-") for row in findings.against_paper]
    assert against_paper(replace(findings, against_paper=rows)) == ""
    assert "<th>Paper</th>" not in contrasts(replace(findings, against_paper=rows))


def test_every_contrast_and_depth_is_in_one_table_ranked_by_p(findings):
    html = contrasts(findings)
    assert html.count("<table") == 1 and "<details" not in html
    tests = re.findall(r'data-column="Student’s p">([^<]*)', html)
    assert len(tests) == len(findings.contrasts)
    known = [float(p.replace("&lt; ", "").strip()) for p in tests if p != "–"]
    assert known == sorted(known) and tests[len(known) :] == ["–"] * (len(tests) - len(known))
    judged = [row for row in findings.against_paper if is_test(row) and row.verdict != "not comparable"]
    assert len(judged) > 2 and len(re.findall(r'class="verdict', html)) == len(judged)
    assert all(typeset(row.why) in html for row in judged)


def test_a_robot_in_a_table_is_linked_to_the_viewer_that_shows_it(findings):
    row = findings.exploiters[0]
    key, address = ("Residual Slush, 9 m", row.trial, -1), f"robot-residual_slush-9m-trial-{row.trial}"
    assert f'1. <a href="#{address}:predicted">' in exploiters(findings, {key: address})
    assert '<a href="#robot-dry_land-1m-trial-0">' in retried(
        findings, {("Dry Land, 1 m", 0, -1): "robot-dry_land-1m-trial-0"}
    )
    assert "#robot" not in exploiters(findings, {}) + retried(findings, {})


def test_the_worst_exploiter_comes_first(findings):
    worst = max(findings.exploiters, key=lambda row: row.excess)
    first = re.search(r'<td data-column="Design">(.*?)</td>', exploiters(findings, {}))[1]
    assert first == f"1. Residual Slush, 9 m, trial {worst.trial}, champion"


def test_luck_shows_its_interval(findings):
    """Losses of 1, 2 and 3 m: mean 2, and ± 4.303 · 1 / √3 = 2.48 by Student's t with 2 degrees of freedom."""
    assert "2.0 −0.5 to 4.5" in words(retried(findings, {}))


def test_the_line_goes_through_the_fitter_parent(findings):
    assert [ancestor.identity for ancestor in main_line(findings.family)] == [21, 9, 3]
    assert "The champion’s line: 3 designs" in words(lineage(findings))
    fitter = replace(
        findings.family,
        ancestors=[replace(a, fitness=9.0) if a.identity == 5 else a for a in findings.family.ancestors],
    )
    assert [ancestor.identity for ancestor in main_line(fitter)] == [21, 5]


def test_a_missing_table_is_replaced_by_its_reason():
    nothing = Findings(missing={"exploiters": "no trial of this study needs networks"})
    assert "no trial of this study needs networks" in exploiters(nothing, {})
    for table in (against_paper(nothing), contrasts(nothing), retried(nothing, {})):
        assert "not available, because" in table


def test_the_tank_table_gives_times_speeds_and_reasons():
    nan = float("nan")
    crossed = Crossing(4.0, 4.1, "too high", 12.7, 12.8, True, seconds=64.0, speed=0.2)
    slow = Crossing(4.0, 1.0, "", 12.7, travelled=-0.3, crossed=False, seconds=nan, speed=-0.002)
    long = Crossing(17.0, 1.2, "too long", -0.3, travelled=5.0, crossed=False, seconds=nan, speed=0.03)
    lost = Crossing(nan, nan, "", nan, travelled=nan, crossed=False, seconds=nan, speed=nan)
    fits = replace(crossed, misfit="")
    never, always = TankTrials(8, 0, 0, 6), TankTrials(8, 8, 8, 0)
    rows = [
        TankRow(0, False, 9.0, 0.2, 0.1, long, slow, fits, 30.0, 142.9, never, never, always),
        TankRow(3, True, 10.0, None, None, crossed, lost, lost, 30.0, 142.9, TankTrials(8, 7, 3, 0), never, never),
    ]
    text = words(tank_tests(Findings(tank=Tank(), tank_tests={"Residual Slush, 2 m": rows}), {}))
    assert "At a scale of 70 mm per simulated metre, the tank measures 16.7 m by 2.14 m" in text
    assert "1 of 2 cross the tank, 0 the dry floor, 1 with the servo’s torque; 2 of them do not fit" in text
    assert "Dry floor, 30 N·m Dry floor, 143 N·m" in text
    none = "crosses 0 of 8 (0)"
    dry = f"0.0 of 88.9 cm backwards {none} immobile 6"  # a wall stops it
    assert f"trial 0 9.0 119 × 8 – too long {none} {dry} 17 s 52.9 mm/s crosses 8 of 8 (8) immobile 0" in text
    assert "✓ trial 3 10.0 28 × 29 17 s 52.9 mm/s too high crosses 7 of 8 (3) – diverged" in text
    assert "The tank is 330 mm wide and 270 mm high. Two pontoons make every robot 325 mm wide" in text
    assert tank_tests(Findings(), {}) == ""


def test_an_interval_is_below_its_number_and_minus_signs_are_true(findings):
    html = against_paper(findings)
    row = next(row for row in findings.against_paper if row.what == "True Slush at 9 m [m]")
    assert f'data-column="This run">{row.this_run}<small>{row.interval}</small>' in html
    assert 'data-column="Paper">−0.8<' in html
    assert re.search(r"R of the members, at 9\u00a0m.*?<small>−?[\d.]+ to [\d.]+ and [\d.]+ to [\d.]+</small>", html)
