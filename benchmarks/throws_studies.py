"""What the penalty, the number of members and the number of throws change, at 9 m and laptop scale.

    python -m benchmarks.throws_studies STORE throws-studies    # the penalty and the members
    python -m benchmarks.throws_studies STORE few-throws        # the number of throws
    python -m benchmarks.throws_studies STORE few-throws-desk   # the same at the paper's scale of evolution

Each variant is a study of the store, with three data sets and ensembles and two trials in each; at the paper's scale
with one trial in each. Writes docs/results/throws-studies.json, few-throws.json or few-throws-desk.json, which
docs/throws.md shows. A run that is stopped resumes. The first two take three quarters of an hour on two cores each, the
last a quarter of an hour.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.published import RESULTS
from pipeline.results.recorded_study import open_study
from pipeline.results.results_file import results_of
from pipeline.store.provenance import environment as provenance

N_REPLICATES = 3
_BASE = {
    "grid.depths": "[9]",
    "grid.environments": "[true_slush,residual_slush,designed_throws]",
    "grid.single_member_depths": "[]",
    "grid.n_trials": "6",
    "replicates": str(N_REPLICATES),
    "assess.n_designs": "600",
}
_AT_PAPERS_SCALE = {"grid.n_trials": "3", "assess.n_designs": "60"}
SERIES = {
    "throws-studies": ("penalty", "members"),
    "few-throws": ("few throws", "few throws, magnitudes"),
    "few-throws-desk": ("few throws, the paper's scale",),
}
_MAGNITUDES = "[a,y,cos_angle,vx,vy,omega,speed,abs_omega,abs_sin_angle]"


@dataclass(frozen=True)
class Variant:
    """A study of a series, and the settings in which it differs from the others."""

    series: str
    name: str  # of the study
    label: str
    settings: Mapping[str, str]
    preset: str = "laptop"


def variants() -> Iterator[Variant]:
    """Yield all studies, series by series; those that share networks come first."""
    for k in (0, 0.5, 1, 2, 3):
        yield Variant(
            "penalty", f"penalty-{k:g}".replace(".", "_"), f"{k:g}", {"ensemble.disagreement_penalty": str(k)}
        )
    alone = {"grid.environments": "[true_slush,single_member,designed_single_member]"}
    yield Variant("members", "members-1", "1", alone | {"ensemble.n_members": "2"})
    for n in (2, 8):
        yield Variant("members", f"members-{n}", str(n), {"ensemble.n_members": str(n)})
    for n in (25, 50, 100, 250, 500):
        size = {"throws.n_throws": str(n), "designed_throws.n_throws": str(n), "designed_throws.n_steps": "200"}
        yield Variant("few throws", f"few-{n}", f"{n} × 200", size)
    for n in (25, 100, 500):
        size = {"designed_throws.n_throws": str(n), "designed_throws.n_steps": "200"}
        observed = {"network.observation": _MAGNITUDES, "grid.environments": "[true_slush,designed_throws]"}
        yield Variant("few throws, magnitudes", f"few-{n}-magnitudes", f"{n} × 200", size | observed)
    for n in (100, 250, 500):
        size = {"throws.n_throws": str(n), "designed_throws.n_throws": str(n), "designed_throws.n_steps": "200"}
        series = "few throws, the paper's scale"
        yield Variant(series, f"few-{n}-desk", f"{n} × 200", size | _AT_PAPERS_SCALE, "desk")


def run(variant: Variant, store: Path) -> None:
    """Compute a study, or resume it."""
    given = {**_BASE, **variant.settings, "name": variant.name}
    options = [part for name, value in given.items() for part in ("--set", f"{name}={value}")]
    command = [sys.executable, "-m", "pipeline", "study", "--preset", variant.preset, "--store", str(store), *options]
    subprocess.run(command, check=True)


def row(variant: Variant, store: Path) -> dict[str, Any]:
    """Return a study's results as a row of the results file."""
    found = results_of(open_study(variant.name, store))
    return {
        "series": variant.series,
        "variant": variant.label,
        "study": variant.name,
        "n_replicates": N_REPLICATES,
        "arms": found["arms"],
        "accuracy": found["accuracy"],
        "champions": found["champions"],
        "digests": found["digests"],
    }


def main() -> None:
    """Run every study of a file and write the file after each, so that a stopped run keeps what it has."""
    store, file = Path(sys.argv[1]), sys.argv[2]
    rows = []
    for variant in (variant for variant in variants() if variant.series in SERIES[file]):
        run(variant, store)
        rows.append(row(variant, store))
        document = {"schema": "puddle.throws_studies", "version": 1, "made_with": dict(provenance()), "studies": rows}
        text = json.dumps(document, indent=1, ensure_ascii=False)
        (RESULTS / f"{file}.json").write_text(f"{text}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
