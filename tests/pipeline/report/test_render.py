"""Tables for readers, in each of the forms that they may ask for."""

import json
import re
from dataclasses import dataclass

from matplotlib.mathtext import MathTextParser

from pipeline.report.render import as_csv, as_html, as_json, as_latex, as_markdown, as_text, written
from tasks.analysis.columns import column, environment_name, percent
from tasks.analysis.estimates import MISSING, Estimate, Mean
from tasks.residual import LEARNERS
from tasks.world import ENVIRONMENTS


@dataclass(frozen=True)
class Reach:
    """Every kind of column."""

    environment: str = column("evolved in", form=environment_name)
    n: int = column("trials", form="{}")
    reach: Mean = column("reach", "m", meaning="Extent at rest & in motion.")
    gain: Estimate = column("gain", "m", form="{:+z.1f}")
    share: float | None = column("share", form=percent)
    verdict: str = column("verdict", form="{}")
    empty: float | None = column("never")
    key: str = column("key", shown=False)


ROWS = [
    Reach("residual_slush", 3, Mean(1.25, 0.5, 3), Estimate(-0.04, -1.0, 2.0), 0.5, "agrees", None, "<k>"),
    Reach("dry_land", 1, Mean(-2.0, None, 1), MISSING, None, "cannot tell", None, "k"),
]
HEADINGS = ["evolved in", "trials", "reach [m]", "gain [m]", "share", "verdict"]


def test_values_are_written_as_their_columns_say():
    """Columns without a value, and those of files alone, are left out; minus signs are true, no zero is negative."""
    columns = written(Reach, ROWS)
    assert [column.heading for column in columns] == HEADINGS
    first, second = ([column.cells[row].text for column in columns] for row in (0, 1))
    assert first == ["Residual Slush, Ê", "3", "1.2 ± 0.5", "+0.0 (−1.0 to +2.0)", "50\u00a0%", "✓ agrees"]
    assert second == ["Dry Land, E′", "1", "−2.0", "–", "–", "? cannot tell"]
    assert "n" not in {column.name for column in written(Reach, ROWS, without=("n",))}


def test_html_has_intervals_below_and_meanings_on_headings():
    html = as_html(Reach, ROWS, "Reach")
    assert re.findall(r'<td [^>]*data-column="(.*?)"', html) == 2 * HEADINGS
    meanings = re.findall(r'<th[^>]* title="(.*?)"', html)
    assert meanings[2] == "Extent at rest &amp; in motion." and not meanings[0]
    assert "<small>−1.0 to +2.0</small>" in html and "<k>" not in html
    linked = as_html(Reach, ROWS, "Reach", address=lambda row: "robot-1" if row.n == 3 else "")
    assert linked.count('href="#robot-1"') == 1


def test_a_terminal_gets_aligned_lines():
    lines = as_text(Reach, ROWS, without=("share",))
    assert max(map(len, lines)) <= 78 and all(line == line.rstrip() for line in lines)
    assert lines[-1].startswith("Dry Land, E′") and lines[-1].endswith("? cannot tell")
    ends = {line.index(word) + len(word) for line, word in ((lines[-2], "1.2 ± 0.5"), (lines[-1], "−2.0"))}
    assert len(ends) == 1


def test_markdown():
    lines = as_markdown(Reach, ROWS).splitlines()
    assert lines[0] == "| evolved in | trials | reach [m] | gain [m] | share | verdict |"
    assert lines[1] == "| --- | --: | --: | --: | --: | --- |" and len(lines) == 4


def test_latex_is_ascii_with_balanced_braces_and_mathematics_that_parses():
    rows = [Reach(name, 1, Mean(1.0, 0.1, 2), MISSING, 0.5, "differs", None, "") for name in (*ENVIRONMENTS, *LEARNERS)]
    text = as_latex(Reach, rows, "Reach of champions")
    body = text[text.index("\\begin") :]
    assert body.isascii() and body.count("{") == body.count("}") and "\\begin{tabular}{lrrrl}" in body
    parts = [body.index(part) for part in ("\\toprule", "\\midrule", "\\bottomrule", "\\end{tabular}")]
    assert parts == sorted(parts)
    assert r"Residual Slush, \^{E} & 1 & 1.0 $\pm$ 0.1 & 50~\% & $\neq$ differs \\" in body
    parser = MathTextParser("path")
    for formula in body.split("$")[1::2]:
        parser.parse(f"${formula}$")


def test_files_have_every_column():
    head, first, _ = as_csv(Reach, ROWS).decode().splitlines()
    assert head == "environment,n,reach,reach_sd,reach_n,gain,gain_low,gain_high,share,verdict,empty,key"
    assert first == "residual_slush,3,1.25,0.5,3,-0.04,-1.0,2.0,0.5,agrees,,<k>"
    rows = as_json(Reach, ROWS)
    assert json.loads(json.dumps(rows)) == rows and rows[1]["share"] is None and rows[0]["gain_low"] == -1.0
