"""Compare robots that sense, and robots of three and nine links, with the paper's: writes controllers.json.

The robots are those of four studies in ./store, one to two hours on a core each; the paper's are in
docs/champions.parquet:

    puddle study --preset desk --set name=reflex --set evolution.controller=reflex --set replicates=5 \
        --set 'grid.environments=[true_slush,dry_land,designed_throws]' --set 'grid.depths=[9, 2]' \
        --set 'grid.single_member_depths=[]' --set 'transfer.adapted_environments=[]'

and the same with name=phase and evolution.controller=phase, name=links-3 and design.n_links={least: 3, most: 3}, and
name=links-9 with 9.
"""

import json
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

import puddle
from pipeline.config.settings import Settings
from pipeline.stages.environments import roll_out, simulation_spec
from pipeline.store.design_file import design_from
from pipeline.store.provenance import environment as provenance
from pipeline.workflow.stage import Execution
from tasks.design import motors_off
from tasks.simulation import Conditions
from tasks.world import TrueSlush

DOCS = Path(__file__).resolve().parents[1]
PAPERS = {"True Slush": "true_slush", "Dry Land": "dry_land", "3,400 designed throws": "designed_throws"}
STUDIES = {"reflex": "`reflex`", "phase": "`phase`", "links-3": "three links", "links-9": "nine links"}
N_DATA_SETS = {9.0: 5, 2.0: 2}  # of the paper's kind, by depth; the studies have five at both
SIMULATION, QUARTER = simulation_spec(Settings(), "true_slush"), Conditions(n_substeps=4)


def scored(row: dict[str, Any]) -> dict[str, Any]:
    """Score a champion in the slush, and unless it evolved on dry land elsewhere; in a current, less its drift."""
    design = design_from(row["design_json"].encode(), row["environment"])

    def displacement(design: puddle.Designs, fluid: str, engine: str = "batch") -> float:
        return float(puddle.simulate(design, fluid, depth=row["depth"], engine=engine).displacement[0])

    def in_quarter_steps() -> float:
        return float(roll_out(SIMULATION, Execution("batch"), TrueSlush(row["depth"]), design, QUARTER).displacement[0])

    scores = {"zero_shot": displacement(design, "true_slush")}
    if row["environment"] != "dry_land":
        scores["quarter_steps"] = in_quarter_steps()
        scores["mujoco"] = displacement(design, "true_slush", "mujoco")
        scores["current"] = displacement(design, "flowing_slush") - displacement(motors_off(design), "flowing_slush")
    known = {name: row[name] for name in ("environment", "depth", "trial")}
    return known | {name: round(score, 4) for name, score in scores.items()}


def main() -> None:
    """Score all champions."""
    papers = [
        row | {"environment": PAPERS[row["made_by"]]}
        for row in pq.read_table(DOCS / "champions.parquet").to_pylist()
        if row["made_by"] in PAPERS
    ]
    found = {
        robots: [row for row in puddle.open_study(name).champions().to_pylist() if row["zero_shot"] is not None]
        for name, robots in STUDIES.items()
    }
    studies = [
        {
            "robots": robots,
            "depth": depth,
            "n_replicates": n if rows is papers else 5,
            "champions": [scored(row) for row in rows if row["depth"] == depth],
        }
        for depth, n in N_DATA_SETS.items()
        for robots, rows in {"six links, open loop": papers, **found}.items()
    ]
    results = {"schema": "puddle.controllers", "version": 1, "made_with": dict(provenance()), "studies": studies}
    text = json.dumps(results, indent=1).replace("\n     ", " ").replace("\n    }", " }")
    (DOCS / "results" / "controllers.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
