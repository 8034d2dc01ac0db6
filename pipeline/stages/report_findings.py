"""From the tables of earlier stages to what the page shows: the analysis, the throws, a champion's family.

Part of the stage report. Whatever is not there leaves its reason in its place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pipeline.report.data import ENVIRONMENTS
from pipeline.report.findings import (
    Accuracy,
    Ancestor,
    Candidate,
    Family,
    Findings,
    Retried,
    Suspect,
    TankTest,
    ThrownPaths,
)
from pipeline.stages import segments
from pipeline.stages.analyse import EXPLOITERS, INSTRUMENTS, MATRIX, MEMBERS, STATISTICS, TANK, read_reasons, read_table
from pipeline.stages.collect import TRANSITIONS, read_transitions
from pipeline.store.encoding import decode_table
from pipeline.store.tables import Columns, rows_of
from pipeline.workflow.stage import Files
from tasks.analysis import (
    Attribution,
    Contrast,
    Estimate,
    EvolvedIn,
    Exploiter,
    Histograms,
    MemberError,
    Regression,
    Row,
    Tank,
    TransferMatrix,
)
from tasks.design import Designs
from tasks.design.genes import GENES
from tasks.evolution import OPERATORS

HISTORIES = "history/"
"""Of inputs: the segments of the trial whose champion's family is shown."""


def arm_words(environment: str, depth: float) -> str:
    """Name an arm in the page's words."""
    labels: dict[str, str] = {name: style.label for name, style in ENVIRONMENTS.items()}
    return f"{labels[environment]}, {depth:g} m"


def arm_name(environment: str, depth: float, trial: int) -> str:
    """Name a trial in the page's words."""
    return f"{arm_words(environment, depth)}, trial {trial}"


def findings(inputs: Mapping[str, Files], *, assessed_depth: float, tank: Tank | None, time_step: float) -> Findings:
    """Gather what the page shows from inputs named ``analyse/<label>``, ``throws-<n>`` and ``history/<trial>/<n>``."""
    analysed = {name.removeprefix("analyse/"): files for name, files in inputs.items() if name.startswith("analyse/")}
    missing = {
        field: reason
        for field, (label, table) in SOURCES.items()
        if (reason := _reason(analysed, label, table)) is not None
    }
    statistics = analysed.get(STATISTICS, {})
    arms = {label: files for label, files in analysed.items() if label.startswith(f"{INSTRUMENTS}/")}
    ensemble = f"{INSTRUMENTS}/residual_slush/{assessed_depth:g}m"
    for label, files in arms.items():  # a reason is shown only where there is nothing else
        told = read_reasons(files)
        if "champions" in told:
            missing["retried"] = told["champions"]
        if "member_errors" in told and label == ensemble:
            missing["member_errors"] = told["member_errors"]
    family = _family(inputs)
    if family is None and any(name.startswith(HISTORIES) for name in inputs):
        missing["family"] = "every design of the trial whose champion it is of diverged"
    return Findings(
        throws=_throws([inputs[name] for name in sorted(inputs) if name.startswith("throws-")], time_step),
        accuracy=_accuracy(statistics, assessed_depth),
        against_paper=_rows(Row, statistics, "paper"),
        contrasts=_rows(Contrast, statistics, "contrasts"),
        attributions=_rows(Attribution, statistics, "attribution"),
        transfer_matrices=_matrices(analysed.get(MATRIX, {})),
        suspects=_suspects(analysed.get(EXPLOITERS, {})),
        retried=[row for label, files in arms.items() for row in _retried(label, files)],
        phantom_thrust=_phantom_thrust(analysed.get(MEMBERS, {})),
        member_errors=_rows(MemberError, arms.get(ensemble, {}), "member_errors"),
        family=family,
        tank_tests=[] if tank is None else _tank_tests(analysed, tank),
        missing=missing,
    )


SOURCES: Mapping[str, tuple[str, str]] = {
    "accuracy": (STATISTICS, "regressions"),
    "against_paper": (STATISTICS, "paper"),
    "contrasts": (STATISTICS, "contrasts"),
    "attributions": (STATISTICS, "attribution"),
    "transfer_matrices": (MATRIX, "matrix"),
    "suspects": (EXPLOITERS, "exploiters"),
    "phantom_thrust": (MEMBERS, "phantom_thrust"),
}
"""Field of Findings -> the item and the table that it comes from, which may say why it is empty."""


def _reason(analysed: Mapping[str, Files], label: str, table: str) -> str | None:
    if label not in analysed:
        return "the analysis that it comes from is not done"
    return read_reasons(analysed[label]).get(table)


def _rows(kind: type, files: Files, table: str) -> list[Any]:
    return rows_of(kind, read_table(files, table)) if files else []


def _estimates(columns: Columns, name: str) -> list[Estimate]:
    return rows_of(Estimate, {"value": columns[name], **{part: columns[f"{name}_{part}"] for part in _REST}})


_REST = ("low", "high", "reason")


def _throws(chunks: Sequence[Files], time_step: float) -> ThrownPaths | None:
    """Lay out the transitions of throws as paths."""
    if not chunks:
        return None
    table = read_transitions([{TRANSITIONS: chunk[TRANSITIONS]} for chunk in chunks])
    order = np.lexsort((table.step, table.throw))
    throws, first = np.unique(table.throw[order], return_index=True)
    path = table.state[order].reshape(len(throws), -1, table.state.shape[1])[:, :, :3].astype(np.float64)
    lengths = table.length_scale[order][first].astype(np.float64)
    return ThrownPaths(lengths, path, seconds=path.shape[1] * time_step)


def _accuracy(files: Files, depth: float) -> Accuracy | None:
    if not files:
        return None
    regressions, drawn = _rows(Regression, files, "regressions"), read_table(files, "histograms")
    names = [name for name in drawn["name"].tolist() if name == "mean" or name.startswith("member ")]
    if not regressions or not names:
        return None
    chosen = np.isin(drawn["name"], names)
    edges = drawn["edges"][0]
    n_bins = len(edges) - 1
    counts = drawn["counts"][chosen].reshape(-1, n_bins, n_bins)
    return Accuracy(depth, regressions, Histograms(tuple(names), edges, counts, drawn["n_outside"][chosen], None))


def _matrices(files: Files) -> dict[EvolvedIn, TransferMatrix]:
    """Put the cells of each environment's matrix, which are there in order, back into their rows."""
    if not files:
        return {}
    cells = read_table(files, "matrix")
    matrices: dict[EvolvedIn, TransferMatrix] = {}
    for environment in dict.fromkeys(cells["environment"].tolist()):
        of = {name: column[cells["environment"] == environment] for name, column in cells.items()}
        trained, tested = np.unique(of["trained"]), np.unique(of["tested"])
        shape = (len(trained), len(tested))
        mean, sd, n, relative = (of[name].reshape(shape) for name in ("mean", "sd", "n", "relative"))
        matrices[environment] = TransferMatrix(trained, tested, mean, sd, n, relative)
    return matrices


def _suspects(files: Files) -> list[Suspect]:
    if not files:
        return []
    columns = read_table(files, "exploiters")
    ranked = rows_of(Exploiter, columns | {"design": np.arange(len(columns["rank"]))})
    names = ("environment", "depth", "trial", "generation", "kind")
    return [
        Suspect(
            f"{arm_name(environment, depth, trial)}, "
            + ("champion" if kind == "champion" else f"of generation {born}"),
            exploiter,
        )
        for exploiter, environment, depth, trial, born, kind in zip(
            ranked, *(columns[name].tolist() for name in names), strict=True
        )
    ]


def _retried(label: str, files: Files) -> list[Retried]:
    _, environment, depth = label.split("/")
    columns = read_table(files, "champions")
    rows = zip(columns["trial"], columns["claimed"], _estimates(columns, "loss"), columns["slush_reach"], strict=True)
    return [
        Retried(arm_name(environment, float(depth.removesuffix("m")), int(trial)), _known(claimed), loss, _known(reach))
        for trial, claimed, loss, reach in rows
    ]


def _tank_tests(analysed: Mapping[str, Files], tank: Tank) -> list[TankTest]:
    found = []
    for label, files in analysed.items():
        if label.startswith(f"{TANK}/"):
            _, environment, depth = label.split("/")
            words = arm_words(environment, float(depth.removesuffix("m")))
            found.append(TankTest(words, tank, rows_of(Candidate, read_table(files, "tank"))))
    return found


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _phantom_thrust(files: Files) -> list[Estimate]:
    return _estimates(read_table(files, "phantom_thrust"), "thrust") if files else []


# -- a champion's family ----------------------------------------------------------------------------------------------


def _family(inputs: Mapping[str, Files]) -> Family | None:
    """Trace the fittest design of a trial back to the random designs that it descends from."""
    names = sorted(name for name in inputs if name.startswith(HISTORIES))
    if not names:
        return None
    tables = [decode_table(inputs[name][segments.HISTORY], schema="history", version=1, source=name) for name in names]
    history = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    if not np.isfinite(history["fitness"]).any():
        return None
    place = {identity: row for row, identity in enumerate(history["identity"].tolist())}
    genes = _gene_matrix(Designs.from_arrays(history))
    waiting = [int(history["identity"][np.argmax(history["fitness"])])]
    found: dict[int, Ancestor] = {}
    while waiting:
        identity = waiting.pop()
        if identity in found:
            continue
        row = place[identity]
        parents = tuple(parent for parent in history["parents"][row].tolist() if parent >= 0)
        changed = [int((genes[row] != genes[place[parent]]).sum()) for parent in parents]
        found[identity] = Ancestor(
            identity,
            generation=int(history["generation"][row]),
            age=int(history["age"][row]),
            operator=OPERATORS[history["operator"][row]],
            parents=parents,
            fitness=float(history["fitness"][row]),
            n_genes_changed=min(changed, default=None),
        )
        waiting += parents
    environment, depth, trial = names[0].removeprefix(HISTORIES).split("/")[:3]
    label = arm_name(environment, float(depth.removesuffix("m")), int(trial.removeprefix("trial-")))
    return Family(label, [found[identity] for identity in sorted(found)])


def _gene_matrix(designs: Designs) -> npt.NDArray[np.float64]:
    """Lay out designs as (n_designs, n_genes), without the root's joint, which nothing depends on."""
    first_link = {"parent": 1, **{gene.name: gene.first_link for gene in GENES}}
    columns = []
    for name, genes in designs.arrays():
        columns.append(genes.reshape(len(designs), -1)[:, first_link[name] :].astype(np.float64))
    return np.concatenate(columns, axis=1)
