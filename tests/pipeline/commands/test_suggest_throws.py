"""puddle suggest-throws: which throws to make next."""

import csv

import numpy as np
import pytest

from pipeline.commands.app import main


def call(*arguments):
    with pytest.raises(SystemExit) as ended:
        main(["suggest-throws", *map(str, arguments)])
    return ended.value.code or 0


def test_it_lists_and_writes_starts(recorded, tmp_path, capsys):
    out = tmp_path / "throws.csv"
    assert call("--study", "tiny", "--store", recorded, "--n", 6, "--out", out) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0].split()[:3] == ["throw", "length", "[m]"] and len(said) == 9 and str(out) in said[-1]
    assert said[-2].startswith("6 throws are ") and "transitions, if followed for" in said[-2]
    rows = list(csv.DictReader(out.open()))
    assert len(rows) == 6 and all(1 <= float(row["length_m"]) <= 3 for row in rows)
    assert np.isfinite([[float(value) for value in row.values()] for row in rows]).all()
    assert [float(line.split()[1]) for line in said[1:7]] == pytest.approx(
        [float(row["length_m"]) for row in rows], abs=0.006
    )


MARKERS = """
tank:
  waterline: 0.1
  corners: [{number: 0, x: 0, y: 0}, {number: 1, x: 1, y: 0}, {number: 2, x: 1, y: 1}, {number: 3, x: 0, y: 1}]
bars:
  - {length: 0.07, width: 0.07, mass: 0.2, tags: [{number: 4, size: 0.02}]}
  - {length: 0.21, width: 0.0233, mass: 0.2, tags: [{number: 5, size: 0.02}]}
"""


def test_at_a_tank_they_are_in_bench_units_and_within_what_can_be_thrown(recorded, tmp_path, capsys):
    """0.07 m per metre and Froude's law: 1 m/s of the simulation is √0.07 m/s."""
    (tmp_path / "markers.yaml").write_text(MARKERS)
    out, sheet = tmp_path / "throws.csv", tmp_path / "throws.html"
    limits = ("--max-speed", 0.4, "--max-spin", 0.5, "--heights", -0.1, 0.15, "--markers", tmp_path / "markers.yaml")
    assert (
        call("--study", "tiny", "--store", recorded, "--n", 12, "--scale", 70, *limits, "--out", out, "--sheet", sheet)
        == 0
    )
    assert "bar [mm]" in capsys.readouterr().out
    rows = np.array([[float(value) for value in row] for row in list(csv.reader(out.open()))[1:]])
    assert set(rows[:, 0]) <= {0.07, 0.21}
    assert rows[:, 1].min() >= -0.1 and rows[:, 1].max() <= 0.15
    assert 0.25 < np.hypot(rows[:, 3], rows[:, 4]).max() <= 0.4001 and np.abs(rows[:, 5]).max() <= np.pi + 1e-3
    page = sheet.read_text()
    assert page.count("<tr>") == 13 and "12 throws to make" in page and "70 mm" in page


def test_a_study_whose_pilots_are_missing(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(
            [
                "collect",
                "--preset",
                "smoke",
                "--set",
                "throws.design=robots",
                "--workers",
                "0",
                "--store",
                str(tmp_path),
            ]
        )
    assert "ω within ± 6.1 rad/s, followed for 100 steps, of which the first 29 are" in capsys.readouterr().err
    assert call("--study", "smoke", "--store", tmp_path) == 2
    said = capsys.readouterr().err
    assert "study smoke: train of member-00 is not done. Run the stages up to pilot first" in said


@pytest.mark.parametrize(
    ("bars", "message"),
    [
        ("", "--markers: expected bars to throw, found none in"),
        (
            "bars: [{length: 0.7, width: 0.1, mass: 0.2, tags: [{number: 4, size: 0.02}]}]",
            "bars are 10 m long, expected one of 1 to 3 m, as robots' links are (in units of the simulation)",
        ),
    ],
)
def test_bars_that_no_robot_resembles_are_refused(recorded, tmp_path, bars, message, capsys):
    markers = tmp_path / "markers.yaml"
    markers.write_text(MARKERS.partition("bars:")[0] + bars)
    assert call("--study", "tiny", "--store", recorded, "--scale", 70, "--markers", markers) == 2
    said = capsys.readouterr().err.strip()
    assert message in said and len(said.splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--heights", "4", "5"], "heights are 4 to 5 m, expected some within 3 m of the surface"),
        (("--n", 0), "--n: expected 1 to 10,000 throws, got 0"),
        (("--throws", "designed_throws"), "no ensemble of replicate 0 of designed_throws: expected one of throws"),
        (("--study", "missing"), "missing"),
        (("--sheet", "throws.html"), "expected its scale in mm per metre, --scale 70"),
        (("--heights", 1, -1), "--heights: expected the lowest first, got 1 -1"),
        (("--heights", "nan", 1), "--heights: expected the lowest first, got nan 1"),
        (("--out", "throws.csv", "--sheet", "./throws.csv", "--scale", 70), "expected another file than that of --out"),
        (("--out", "/nowhere/throws.csv"), "writing throws"),
    ],
)
def test_a_mistake_is_one_message(recorded, arguments, message, capsys):
    assert call("--study", "tiny", "--store", recorded, *arguments) == 2
    said = capsys.readouterr().err.strip()
    assert message in said and len(said.splitlines()) == 1
