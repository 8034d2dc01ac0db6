"""Score the published champions in other conditions: `.venv/bin/python docs/results/robustness.py`, ten minutes.

It writes robustness.json: every champion of docs/champions.parquet in true slush, with the columns of the table
``robustness`` [m], and two more: in MuJoCo, at three depths; and where the slush's change is added after the solver.
"""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from other_fluids import LateSlush

import puddle
from pipeline.config.settings import Settings
from pipeline.stages.environments import roll_out, simulation_spec
from pipeline.store.provenance import environment as provenance
from pipeline.workflow.stage import Execution
from tasks.analysis.tables.transfer_robustness import CONDITIONS
from tasks.design import motors_off
from tasks.simulation import Conditions
from tasks.world import Pool, TrueSlush

DOCS = Path(__file__).resolve().parents[1]
SIMULATION = simulation_spec(Settings(), "true_slush")
IN_MUJOCO = (0.0, 2.0, 9.0)  # depths [m]


def main() -> None:
    """Score the champions depth by depth."""
    table = pq.read_table(DOCS / "champions.parquet").select(["environment", "made_by", "depth", "trial", "data_set"])
    designs, depths = puddle.open_designs(DOCS / "champions.parquet"), np.array(table["depth"])
    scores = {name: np.full(len(designs), np.nan) for name in (*CONDITIONS, "passive", "added_late", "mujoco")}
    for depth in np.unique(depths):
        own, target = depths == depth, TrueSlush(depth=float(depth))

        def score(designs: puddle.Designs, conditions: Conditions, target: TrueSlush = target) -> np.ndarray:
            return roll_out(SIMULATION, Execution("batch"), target, designs, conditions).displacement

        for name, conditions in CONDITIONS.items():
            scores[name][own] = np.mean([score(designs[own], one) for one in conditions], axis=0)
        scores["passive"][own] = score(motors_off(designs[own]), Conditions())
        scores["added_late"][own] = puddle.simulate(designs[own], Pool(float(depth), LateSlush())).displacement
        if depth in IN_MUJOCO:
            scores["mujoco"][own] = puddle.simulate(designs[own], target, engine="mujoco").displacement
    rows = [
        row | {name: round(float(values[i]), 4) for name, values in scores.items() if np.isfinite(values[i])}
        for i, row in enumerate(table.to_pylist())
    ]
    results = {"schema": "puddle.robustness", "version": 1, "made_with": dict(provenance()), "champions": rows}
    text = json.dumps(results, indent=1).replace("\n   ", " ").replace("\n  }", " }")
    (DOCS / "results" / "robustness.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
