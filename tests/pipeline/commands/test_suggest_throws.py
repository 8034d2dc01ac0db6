"""puddle suggest-throws: the throws that would teach a study's networks most."""

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
    assert said[0].split()[:3] == ["throw", "length", "[m]"] and len(said) == 8 and str(out) in said[-1]
    rows = list(csv.DictReader(out.open()))
    assert len(rows) == 6 and all(1 <= float(row["length_m"]) <= 3 for row in rows)
    assert np.isfinite([[float(value) for value in row.values()] for row in rows]).all()
    assert [float(line.split()[1]) for line in said[1:7]] == pytest.approx(
        [float(row["length_m"]) for row in rows], abs=0.006
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--n", 0), "--n: expected 1 to 10,000 throws, got 0"),
        (("--throws", "designed_throws"), "no ensemble of replicate 0 of designed_throws: expected one of throws"),
        (("--study", "missing"), "missing"),
        (("--out", "/nowhere/throws.csv"), "writing throws"),
    ],
)
def test_a_mistake_is_one_message(recorded, arguments, message, capsys):
    assert call("--study", "tiny", "--store", recorded, *arguments) == 2
    said = capsys.readouterr().err.strip()
    assert message in said and len(said.splitlines()) == 1
