from dataclasses import replace

import numpy as np
import pytest
from command_line import call, refused

from pipeline.commands.power import power_lines
from pipeline.results.recorded_study import open_study
from tasks.analysis.statistical_power import n_trials_for


def test_a_row_for_each_arm_and_the_trials_that_its_deviation_needs(recorded, capsys):
    assert call("power", "tiny", "--store", str(recorded), "--difference", "0.1", "--difference", "3") == 0
    heading, columns, *rows = capsys.readouterr().out.splitlines()
    assert "with a probability of 80%" in heading and columns.split()[-4:] == ["0.1", "m", "3", "m"]
    assert len(rows) == 5  # four arms zero-shot, one of them adapted
    champions = open_study("tiny", recorded).table("champions", environment="dry_land").to_pylist()
    sd = np.std([row["adapted"] for row in champions], ddof=1)
    (row,) = (row for row in rows if "dry_land" in row and "adapted" in row)
    assert int(row.split()[-2].replace(",", "")) == n_trials_for(0.1, sd)
    assert all(len(row) <= 80 for row in rows)


def test_it_says_where_trials_share_data_sets(recorded):
    study = open_study("tiny", recorded)
    shared = study.settings.model_copy(update={"replicates": 2})
    lines, with_note = (list(power_lines(of, [1.0], 0.8)) for of in (study, replace(study, settings=shared)))
    assert with_note[:-1] == lines and "share 2 data sets" in with_note[-1]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["tiny", "--difference", "0"], "--difference: expected a difference above 0 m, got 0"),
        (["tiny", "--difference", "nan"], "--difference: expected a difference above 0 m, got nan"),
        (["tiny", "--power", "1"], "--power: expected a probability between 0 and 1, got 1"),
        (["nosuch"], "holds tiny"),
    ],
)
def test_bad_arguments(recorded, capsys, arguments, said):
    assert said in refused(capsys, "power", *arguments, "--store", str(recorded))
