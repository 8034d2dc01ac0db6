"""The table of transfer in LaTeX: the numbers of the page, in ASCII that pdflatex reads."""

import re

from matplotlib.mathtext import MathTextParser

from pipeline.report import data
from pipeline.report.data import TrialResult
from pipeline.report.transfer_latex import transfer_latex
from tasks.world import ENVIRONMENTS


def rows(text: str) -> list[list[str]]:
    """Return the cells of each row, after the depth under whose heading it stands."""
    found, depth = [], ""
    for line in text.splitlines():
        if heading := re.match(r"\\multicolumn\{9\}\{@\{\}l\}\{\\textit\{(.*) deep\}\} \\\\$", line):
            depth = heading[1]
        elif line.endswith(r"\\"):
            found.append([depth, *line.removesuffix(r" \\").split(" & ")])
    return found


def test_the_rows_are_those_of_the_page(study):
    head, *body = rows(transfer_latex("tiny", study.trials, selected_for="displacement"))
    assert head[3:] == [r"predicted $\mu$", r"$\sigma$", "fitness", "zero-shot", r"\% of $E$", "adapted", r"\% of $E$"]
    assert {len(row) for row in (head, *body)} == {10}
    slush = next(row for row in body if row[:2] == [r"9\,m", "True Slush $E$"])
    found = data.trial_mean(data.arm(study.trials, "true_slush", 9.0), "zero_shot")
    assert (
        slush[4:6] == ["--", "--"]
        and slush[6] == rf"${found.mean:.1f}\,{{\pm}}\,{found.sd:.1f}$"
        and slush[7] == "$100$"
    )
    land = next(row for row in body if row[:2] == [r"9\,m", "Dry Land $E'$"])
    assert land[6].startswith("$-1.0") and land[7].startswith("$-")
    assert [row[1].split("$")[1] for row in body if row[0] == r"9\,m"] == ["E", "E'", r"\hat{E}", r"\hat{E}_{1}"]


def test_it_is_ascii_with_balanced_braces_and_mathematics_that_parses(study):
    text = transfer_latex("tiny", study.trials, selected_for="displacement")
    assert text.isascii() and text.count("{") == text.count("}")
    assert "selected for: displacement." in text
    begin, end = text.index(r"\begin{tabular}{@{}l*{8}{@{\hspace{8pt}}r}@{}}"), text.index(r"\end{tabular}")
    assert begin < text.index(r"\toprule") < text.index(r"\midrule") < text.index(r"\bottomrule") < end
    parser = MathTextParser("path")
    for formula in re.findall(r"\$[^$]+\$", text[begin:end]):
        parser.parse(formula)


def test_what_is_missing_is_a_dash():
    trials = [TrialResult("dry_land", 2.0, 0, predicted=3.0, zero_shot=float("nan"))]
    (row,) = rows(transfer_latex("tiny", trials, selected_for="displacement"))[1:]
    assert row == [r"2\,m", "Dry Land $E'$", "1", "$3.0$", *6 * ["--"]]


def test_an_ensemble_has_its_deviation_and_fitness():
    trials = [
        TrialResult("residual_slush", 2.0, 0, predicted=3.0, predicted_sd=0.5, fitness=2.5),
        TrialResult("single_member", 2.0, 0, predicted=3.0, fitness=3.0),
    ]
    ensemble, single = rows(transfer_latex("tiny", trials, selected_for="displacement"))[1:]
    assert ensemble[3:6] == ["$3.0$", "$0.5$", "$2.5$"] and single[3:6] == ["$3.0$", "--", "--"]


def test_every_registered_symbol_is_written_in_ascii():
    trials = [TrialResult(name, 1.0, 0, 1.0, 1.0) for name in ENVIRONMENTS]
    assert transfer_latex("tiny", trials, selected_for="displacement").isascii()
