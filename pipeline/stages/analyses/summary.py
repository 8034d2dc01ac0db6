"""The results of the stage analyse in the terminal and as metrics by which studies are compared.

Part of the stage analyse, whose page lists the tables.
"""

import itertools
import textwrap
from collections.abc import Callable, Mapping, Sequence
from math import isfinite

import numpy as np

from pipeline.report.findings import ExploiterRow, TankRow
from pipeline.stages.analyses.analysis_tables import read_rows
from pipeline.stages.analyses.instruments import ThrustRow
from pipeline.stages.analyses.specs import EXPLOITERS, MEMBERS, STATISTICS, TANK
from pipeline.stages.part import PartId
from pipeline.workflow.identity import Arm, ChainId, TrialId
from pipeline.workflow.stage import Files
from tasks.analysis.against_paper import Row
from tasks.analysis.attribution import Attribution
from tasks.analysis.equivalence import VERDICTS
from tasks.analysis.paper import is_t_test
from tasks.analysis.prediction import Regression, is_member, mean_less_deviations
from tasks.analysis.tank import Crossing, Tank, TankTrials
from tasks.analysis.variance_split import VarianceRow
from tasks.world import ENVIRONMENTS

Highlights = tuple[list[str], dict[str, float]]  # lines for the terminal, and metrics

_HEADINGS = ("", "paper", "this run (95 %)", "verdict")
_COLUMN_WIDTHS = (30, 12, 16, 14)  # with two spaces between them and the terminal's indent, 80 columns

_AGGREGATE_METRICS = {mean_less_deviations(0): "mean", mean_less_deviations(1): "mean_less_1_sd"}


def highlights(found: Mapping[ChainId, Files], tank: Tank | None) -> Highlights:
    """Summarise the analyses that are done: their files by identity."""
    summaries: Mapping[str, Callable[[Files], Highlights]] = {
        STATISTICS: _statistics,
        MEMBERS: _members,
        EXPLOITERS: _exploiters,
    }
    parts = [summarise(found[identity]) for kind, summarise in summaries.items() if (identity := PartId(kind)) in found]
    for analysis, files in found.items():
        if tank is not None and isinstance(analysis, PartId) and analysis.name == TANK and analysis.arm:
            parts.append(_tank(analysis.arm, files, tank))
    metrics = {name: value for _, of_part in parts for name, value in of_part.items()}
    return [part for lines, _ in parts for line in lines for part in wrapped(line)], metrics


def _statistics(files: Files) -> Highlights:
    """List the paper's numbers beside this run's; the metrics are ratios and regressions."""
    rows = read_rows(files, "paper", Row)
    shown = [row for row in rows if not is_t_test(row.what) and not row.what.startswith("the built robot")]
    lines = _table([(row.what, row.paper, f"{row.this_run}\n{_bracketed(row.interval)}", row.verdict) for row in shown])
    tests = [row.verdict for row in rows if is_t_test(row.what)]
    counts = ", ".join(f"{verdict} {tests.count(verdict)}" for verdict in VERDICTS)
    lines.append(f"verdicts on the paper's {len(tests)} t tests: {counts}")
    lines += _variances(read_rows(files, "variance", VarianceRow))
    metrics: dict[str, float | None] = {
        f"paper.n_{verdict}": float(sum(row.verdict == verdict for row in rows)) for verdict in ("agrees", "differs")
    }
    for gap in read_rows(files, "attribution", Attribution):
        arm = Arm(gap.evolved_in, gap.depth).label.replace("/", ".")
        metrics[f"ratio_to_true_slush.zero_shot.{arm}"] = gap.recovered_zero_shot.value
        metrics[f"ratio_to_true_slush.adapted.{arm}"] = gap.recovered_adapted.value
    fits = read_rows(files, "regressions", Regression)
    for fit in (fit for fit in fits if fit.learned_from == fits[0].learned_from):  # those of the main ensemble
        if fit.name in _AGGREGATE_METRICS or is_member(fit.name):
            name = _AGGREGATE_METRICS.get(fit.name, fit.name.replace(" ", "-"))
            metrics |= {f"accuracy.r.{name}": fit.r.value, f"accuracy.slope.{name}": fit.slope.value}
    return lines, _known(metrics)


def _variances(rows: Sequence[VarianceRow]) -> list[str]:
    """Split the deviation of the zero-shot displacement at the greatest depth, in a line; none without replicates."""
    known = [row for row in rows if row.n_replicates > 1 and row.quantity == "zero_shot"]
    deepest = [row for row in known if row.depth == max(row.depth for row in known)]
    parts = [
        f"{ENVIRONMENTS[row.evolved_in].label} {row.sd_between:.1f} and {row.sd_within:.1f} m"
        for row in deepest
        if row.sd_between is not None and row.sd_within is not None
    ]
    if not parts:
        return []
    return [
        f"SD of zero-shot at {deepest[0].depth:g} m between replicates (throws and training, which change together) "
        f"and within: {', '.join(parts)}"
    ]


def _table(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lay out the comparison with the paper, its cells wrapped to the widths of their columns."""
    lines = []
    for row in (_HEADINGS, *rows):
        cells = [
            [part for line in cell.splitlines() for part in textwrap.wrap(line, width, break_on_hyphens=False)]
            for cell, width in zip(row, _COLUMN_WIDTHS, strict=True)
        ]
        for parts in itertools.zip_longest(*cells, fillvalue=""):
            line = "  ".join(f"{part:<{width}}" for part, width in zip(parts, _COLUMN_WIDTHS, strict=True))
            lines.append(line.rstrip())
    return lines


def _bracketed(interval: str) -> str:
    return f"({interval})" if interval else ""


def wrapped(line: str) -> list[str]:
    """Break a long line of the summary, so that it fits where the table fits."""
    return textwrap.wrap(line, sum(_COLUMN_WIDTHS) + 2 * len(_COLUMN_WIDTHS) - 2, subsequent_indent="    ")


def _members(files: Files) -> Highlights:
    rows = read_rows(files, "phantom_thrust", ThrustRow)
    metrics = _known({f"phantom_thrust.member-{row.member}": row.thrust.value for row in rows})
    if not metrics:
        return [], {}
    thrusts = list(metrics.values())
    metrics["phantom_thrust.rms"] = float(np.sqrt(np.mean(np.square(thrusts))))
    return [f"phantom thrust of the members: {', '.join(f'{value:+.4f}' for value in thrusts)} m/s²"], metrics


def _exploiters(files: Files) -> Highlights:
    """Name the champion that exploits the ensemble most."""
    for row in read_rows(files, "exploiters", ExploiterRow):
        if row.kind == "champion" and row.excess is not None:
            label = TrialId("evolve", row.environment, row.depth, row.trial).label
            line = f"champion that exploits the ensemble most: {label}, predicted {row.predicted:z.1f} m, "
            return [f"{line}true {row.true:z.1f} m"], {"hallucinated.worst_champion": row.excess}
    return [], {}


def _tank(arm: Arm, files: Files, tank: Tank) -> Highlights:
    """Name the champion to build, with its results in the tank."""
    rows = read_rows(files, "tank", TankRow)
    best = next((row for row in rows if row.proposed), None)
    if best is None:
        return [], {}
    label = PartId(TANK, arm).label
    mean = np.mean([row.zero_shot for row in rows if row.zero_shot is not None])
    dry_land = "diverged" if best.dry_land is None else f"{best.dry_land:.2f} m"
    lines = [
        f"{label}: to build: the champion of trial {best.trial}, {best.zero_shot:.2f} m in True Slush, nearest to the "
        f"champions' mean of {mean:.2f} m; on Dry Land {dry_land}",
        f"{label}: in the tank, {tank.simulated_length:.1f} m x {tank.simulated_depth:.2f} m in the simulation, the "
        f"built robot {_outcome(best.wet, tank)} ({1000 * tank.built_speed(best.wet.speed):.0f} mm/s); on the dry "
        f"floor it {_outcome(best.dry, tank)}",
        f"{label}: it is {_size(best.wet, tank)} as built, and {_fit(best)}",
        f"{label}: it crosses the tank in {_of_trials(best.wet_trials)}, "
        f"its dry floor in {_of_trials(best.dry_trials)}",
        f"{label}: on the dry floor it ends within {100 * tank.immobile:g} cm of its start in "
        f"{_immobile(best.dry_trials)} with the simulation's {best.motor_torque:.0f} N·m, and in "
        f"{_immobile(best.dry_servo_trials)} with the {best.servo_torque:.0f} N·m of the servo at scale, with which it "
        f"crosses in {_of_trials(best.dry_servo_trials)}",
        f"{label}: {sum(row.wet.crossed for row in rows)} of {len(rows)} champions cross the tank, "
        f"{sum(row.dry.crossed for row in rows)} its dry floor, and {sum(row.dry_servo.crossed for row in rows)} with "
        f"the servo's torque; {sum(bool(row.wet.misfit or row.dry.misfit) for row in rows)} of them do not fit into it",
    ]
    metrics = {
        "zero_shot": best.zero_shot,
        "dry_land": best.dry_land,
        "wet_crossed": float(best.wet.crossed),
        "wet_share_crossed": best.wet_trials.n_crossed / best.wet_trials.n,
        "wet_seconds": best.wet.seconds,
        "wet_speed": best.wet.speed,
        "dry_crossed": float(best.dry.crossed),
        "dry_travelled": best.dry.travelled,
        "dry_share_immobile": best.dry_trials.n_immobile / best.dry_trials.n,
        "dry_servo_share_immobile": best.dry_servo_trials.n_immobile / best.dry_servo_trials.n,
    }
    prefix = f"tank.{arm.label.replace('/', '.')}.proposed"
    return lines, _known({f"{prefix}.{name}": value for name, value in metrics.items()})


def _of_trials(trials: TankTrials) -> str:
    slower = trials.n_crossed_at_kept_frequencies
    return f"{trials.n_crossed} of {trials.n} trials ({slower} at the simulation's frequencies)"


def _immobile(trials: TankTrials) -> str:
    return f"{trials.n_immobile} of {trials.n} trials"


def _size(found: Crossing, tank: Tank) -> str:
    """State a robot's size as built."""
    length, height = 100 * tank.scale * found.length, 100 * tank.scale * found.height
    return f"{length:.0f} cm long, {height:.0f} cm high and {100 * tank.robot_width:.1f} cm wide"


def _fit(row: TankRow) -> str:
    """Say whether a robot fits into the tank, filled and drained."""
    filled, drained = row.wet.misfit, row.dry.misfit
    if not filled and not drained:
        return "fits into the tank"
    if filled == drained:
        return f"does not fit into the tank: it is {filled}"
    both = ((filled, "in the filled one"), (drained, "in the drained one"))
    return f"does not fit into the tank: it is {' and '.join(f'{why} {where}' for why, where in both if why)}"


def _outcome(found: Crossing, tank: Tank) -> str:
    """Describe how far a robot travelled, in metres and seconds of the built robot."""
    if found.crossed:
        return f"crosses in {tank.built_seconds(found.seconds):.0f} s"
    if not isfinite(found.travelled):
        return "diverged"
    if not tank.lets_pass(found.distance):
        return f"is {found.misfit}"
    travelled_cm, distance_cm = (100 * tank.scale * metres for metres in (found.travelled, found.distance))
    return f"travels {travelled_cm:z.1f} of {distance_cm:.1f} cm in {tank.seconds:g} s"


def _known(metrics: Mapping[str, float | None]) -> dict[str, float]:
    return {name: value for name, value in metrics.items() if value is not None and isfinite(value)}
