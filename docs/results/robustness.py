"""Score the published champions in other conditions: `.venv/bin/python docs/results/robustness.py`, two minutes.

It writes robustness.json: every champion of docs/champions.parquet in true slush, with the columns of the table
``robustness`` [m].
"""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

import puddle
from pipeline.config.settings import Settings
from pipeline.stages.environments import roll_out, simulation_spec
from pipeline.store.provenance import environment as provenance
from pipeline.workflow.stage import Execution
from tasks.analysis.tables.transfer_robustness import CONDITIONS
from tasks.design import motors_off
from tasks.simulation import Conditions
from tasks.world import TrueSlush

DOCS = Path(__file__).resolve().parents[1]
SIMULATION = simulation_spec(Settings(), "true_slush")


def main() -> None:
    """Score the champions depth by depth."""
    table = pq.read_table(DOCS / "champions.parquet").select(["environment", "made_by", "depth", "trial"])
    designs, depths = puddle.open_designs(DOCS / "champions.parquet"), np.array(table["depth"])
    scores = {name: np.empty(len(designs)) for name in (*CONDITIONS, "passive")}
    for depth in np.unique(depths):
        own, target = depths == depth, TrueSlush(depth=float(depth))

        def score(designs: puddle.Designs, conditions: Conditions, target: TrueSlush = target) -> np.ndarray:
            return roll_out(SIMULATION, Execution("batch"), target, designs, conditions).displacement

        for name, conditions in CONDITIONS.items():
            scores[name][own] = np.mean([score(designs[own], one) for one in conditions], axis=0)
        scores["passive"][own] = score(motors_off(designs[own]), Conditions())
    rows = [
        row | {name: round(float(values[i]), 4) for name, values in scores.items()}
        for i, row in enumerate(table.to_pylist())
    ]
    results = {"schema": "puddle.robustness", "version": 1, "made_with": dict(provenance()), "champions": rows}
    text = json.dumps(results, indent=1).replace("\n   ", " ").replace("\n  }", " }")
    (DOCS / "results" / "robustness.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
