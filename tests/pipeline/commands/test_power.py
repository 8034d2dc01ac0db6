from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest
from command_line import call, refused

from pipeline.commands.power import power_lines
from pipeline.results.recorded_study import Study, open_study
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


def test_variance_between_replicates_counts_in_arms_with_networks(recorded, monkeypatch):
    """Even trials at 2 m and odd ones at 6 m, three of each: replicates deviate by √8, and trials by √(24 / 5).

    Cohen's 26 replicates for an effect of 0.8 have 78 trials. Trials of True Slush depend on no replicate.
    """
    opened = open_study("tiny", recorded)
    study = replace(opened, settings=opened.settings.model_copy(update={"replicates": 2}))
    rows = [
        {"environment": environment, "depth": 1.0, "trial": k, "zero_shot": zero_shot}
        for environment in ("true_slush", "residual_slush")
        for k, zero_shot in enumerate([1.0, 5.0, 2.0, 6.0, 3.0, 7.0])
    ]
    table = pa.Table.from_pylist(rows, schema=opened.champions().schema)
    monkeypatch.setattr(Study, "champions", lambda self: table)
    difference = 0.8 * np.sqrt(8)
    *_, true, residual, note = power_lines(study, [difference], 0.8)
    sd = np.sqrt((4 + 24) / 5)  # squares within replicates, and of their means
    assert true.split() == ["1", "m", "true_slush", "zero-shot", "6", f"{sd:.2f}", str(n_trials_for(difference, sd))]
    assert residual.split()[-3:] == ["6", f"{np.sqrt(24):.2f}", "78"]
    assert "belong to 2 replicates" in note and "independent" not in note and "take three to five" in note
    assert len(list(power_lines(opened, [difference], 0.8))) == 4  # without a note where there is one replicate


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
