"""Record what the study `pontoon` gives: `python -m benchmarks.robot_to_build STORE KIT`.

KIT is what `puddle fabricate --study pontoon` wrote. Writes docs/results/pontoon.json, which docs/results.md and
docs/bench-robot.md show: where the champions get, how they fare in the virtual tank, and whether the kit has faults.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from benchmarks.published import RESULTS
from pipeline.results.recorded_study import open_study
from pipeline.results.results_file import results_of

_STUDY = "pontoon"
_TESTS = {
    "wet_trials_n_crossed": ("crosses the filled tank", (8, 8)),
    "dry_trials_n_crossed": ("crosses its dry floor, with the simulation's motors of 30 N·m", (0, 6)),
    "dry_trials_n_immobile": ("… and ends within 5 cm of its start", (6, 6)),
    "dry_servo_trials_n_crossed": (
        "crosses its dry floor, with the torque of a 20 kg·cm servo at scale, 143 N·m",
        (0, 6),
    ),
    "dry_servo_trials_n_immobile": ("… and ends within 5 cm of its start", (6, 6)),
}
"""Columns of the table of the tank: what they count, and the paper's count of its own robot."""


def tank_rows(tank: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return how many trials in the tank do what: [n that do, n] of the paper's robot, the proposed one and all."""
    (proposed,) = (row for row in tank if row["proposed"])
    rows = []
    for column, (test, papers) in _TESTS.items():
        n_trials = f"{column.partition('_n_')[0]}_n"
        of_all = [sum(row[name] for row in tank) for name in (column, n_trials)]
        rows.append({"test": test, "paper": papers, "proposed": [proposed[column], proposed[n_trials]], "all": of_all})
    return rows


def main() -> None:
    """Write the file."""
    store, kit = (Path(argument) for argument in sys.argv[1:])
    study, made = open_study(_STUDY, store), json.loads((kit / "kit.json").read_text(encoding="utf-8"))
    results, tank = results_of(study), study.table("tank").to_pylist()
    (proposed,) = (row for row in tank if row["proposed"])
    crossed = [row for row in tank if row["wet_trials_n_crossed"] == row["wet_trials_n"]]
    document = {
        "schema": "puddle.robot_to_build",
        "version": 1,
        "made_with": results["made_with"],
        "digests": results["digests"],
        "core_seconds": results["core_seconds"],
        "arms": results["arms"],
        "champions": results["champions"],
        "tank": tank_rows(tank),
        "n_champions": {
            "all": len(tank),
            "cross the filled tank in every trial": len(crossed),
            "and its dry floor in none": sum(row["dry_trials_n_crossed"] == 0 for row in crossed),
            "fit into the filled tank": sum(not row["wet_misfit"] for row in tank),
        },
        "proposed": {name: value for name, value in proposed.items() if value == value},  # without NaN
        "outside": [
            {"trial": row["trial"], "share_outside": row["share_outside"]}
            for row in study.table("champion_coverage").to_pylist()
            if row["component"] == "all"
        ],
        "kit": {"metrics": made["metrics"], "findings": made["findings"]},
    }
    (RESULTS / "pontoon.json").write_text(f"{json.dumps(document, indent=1, ensure_ascii=False)}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
