"""analyse: what the study shows, as tables. Paper, "Results", and what it leaves open: where the ensemble hallucinates.

Each chain is one item. Its tables are Parquet (schema = the file's name without suffix; read them with
:func:`read_table`). A number that is not there is NaN, a text is empty. An estimate X is four columns: X, X_low, X_high
(95 %) and X_reason (why X or its interval is missing). Beside its tables each item has ``reasons.json``: by table, why
it has no rows or lacks something; {} if all is there. Lengths in m unless said.

``statistics``, from scores and predictions alone:
    scores.parquet       a row per trial: environment, depth, trial, predicted, zero_shot, zero_shot_com,
                         zero_shot_reach (root less centre of mass), adapted, adapted_com, adapted_reach, status ("ok",
                         or why not)
    regressions.parquet  a row per predictor ("member 0", "mean", "mean - 1 sd", "min", ...): name, n, n_left_out, and
                         the estimates slope, intercept [m], r
    histograms.parquet   a row per member, mean and mean - 1 sd: name, n_outside, edges (n_bins + 1 numbers, of both
                         axes), counts (n_bins² numbers: reshape to predicted by true)
    contrasts.parquet    a row per contrast and depth: a, b ("dry_land/adapted"), depth, then of each side X = a, b:
                         X_n, X_n_left_out, the estimate X_mean, X_sd; of each test T = student, welch, mann_whitney:
                         T_statistic, T_p, T_reason; the estimates hedges_g and ratio; T_holm (p over the depths)
    attribution.parquet  a row per arm and depth: evolved_in, depth, n, n_best, and the estimates predicted, zero_shot,
                         adapted, best, hallucinated, gap, lost_to_controller, lost_to_body, controller_share,
                         body_share, recovered_zero_shot, recovered_adapted, recovered_of_dry_land
    paper.parquet        a row per number of the paper: what, paper, source, this_run, verdict ("agrees", "differs",
                         "not comparable"), why, value, interval (in words: 95 %, of a range those of its ends), low,
                         high (ends of the 95 % interval of value), p; value is of a range its median, of a t test the
                         difference of the means
``members``, from networks and throws:
    phantom_thrust.parquet  a row per member: member, the estimate thrust [m/s²] (needs no True Slush)
    member_errors.parquet   on the throws held out, a row per member, component, band and immersion: member,
                            component, band, immersion, n_rows, bias, rmse, rms_true [m/s², m/s², rad/s²]
``transfer-matrix``, champions of every trial tested at every depth in True Slush:
    tests.parquet        environment, trained, trial, tested, displacement, com_displacement
    matrix.parquet       environment, trained, tested, mean, sd, n, relative (to the champions at home there)
``exploiters``, every champion and every assessed design, the worst first:
    exploiters.parquet   rank, kind ("champion", "assessed"), environment, depth, trial, generation and identity (-1
                         of a champion), predicted (by the ensemble, or by the champion's own single member), true,
                         excess, disagreement (σ over members), ranked_by, reason, by_member (n_members numbers)
``instruments/<environment>/<depth>m``, the champions of one arm; links and worlds are of the best zero-shot champion,
the one that the page films (where none survives True Slush, of the best where it evolved):
    champions.parquet    a row per champion: trial, best; home_displacement, home_com, home_reach where it evolved
                         (mean over members); slush_displacement, slush_com, slush_reach; winner's luck: claimed
                         (fitness where it evolved), again (mean of its tries), the estimate loss, share_below,
                         n_diverged, n_tries
    links.parquet        a row per world, step and link, in that order: world ("true_slush"; then where it evolved, if
                         that is elsewhere), step, link, disagreement [m/s²], novelty (1 is usual), distance
                         [deviations], component (of SPACE; "" unknown), departure and thrust (n_members numbers
                         each, m/s²)
    worlds.parquet       a row per world in links: world, member (whose world it is, -1 for nobody's: of an ensemble,
                         the member that promises the median), trial, displacement, disagreement (mean), share_novel
                         (novelty above 1: half of fresh throws), thrust (n_members numbers: mean departure along x)
    member_errors.parquet   as of ``members``, along the rollouts of all the arm's champions in True Slush
``tank/<environment>/<depth>m``, the champions of one arm and which to build, where the settings have a tank:
    tank.parquet         a row per champion: trial, proposed; zero_shot, dry_land, dry_land_com; of each X = wet, dry
                         (the tank filled and drained): X_length, X_distance, X_travelled [m of simulation], X_crossed,
                         X_seconds, X_speed [of simulation]
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import ceil
from pathlib import PurePosixPath
from typing import Any, TypeVar

import numpy as np

from pipeline.config.settings import Settings
from pipeline.stages import environments
from pipeline.stages.analyses import champions, instruments, statistics, tank_tests
from pipeline.stages.analyses.specs import (
    AnalysisId,
    AnalysisItemSpec,
    AnalysisSpec,
    ExploitersSpec,
    InstrumentsSpec,
    MatrixSpec,
    MembersSpec,
    StatisticsSpec,
    TankSpec,
)
from pipeline.stages.analyses.statistics import Reasons, Tables
from pipeline.stages.assess import ASSESSED, ASSESSED_ENVIRONMENTS, PREDICTIONS
from pipeline.stages.collect import data_set
from pipeline.stages.transfer import scores_inputs
from pipeline.store.encoding import decode_json, decode_table, encode_json, encode_table
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.store.tables import Columns, csv_of, rows_of
from pipeline.workflow.identity import Arm, InputName, TrialId, arms_of, trials_of
from pipeline.workflow.stage import (
    Chain,
    Execution,
    Files,
    Input,
    Inputs,
    Item,
    Job,
    MissingInputs,
    Results,
    Stage,
    Summary,
    Upstream,
)
from tasks.analysis import Tank
from tasks.analysis.prediction import mean_less_deviations
from tasks.world import ENVIRONMENTS, EnvironmentName

_VERSION = 4

STATISTICS, MEMBERS, MATRIX, EXPLOITERS, INSTRUMENTS, TANK = (
    "statistics",
    "members",
    "transfer-matrix",
    "exploiters",
    "instruments",
    "tank",
)
"""Kinds of analyses."""

REASONS = "reasons.json"

AnyRow = TypeVar("AnyRow")

_COMPUTE: Mapping[type[AnalysisSpec], Callable[[Job[Any], Inputs], tuple[Tables, Reasons]]] = {
    StatisticsSpec: statistics.compute,
    MembersSpec: instruments.compute_members,
    MatrixSpec: champions.compute_matrix,
    ExploitersSpec: champions.compute_exploiters,
    InstrumentsSpec: instruments.compute_arm,
    TankSpec: tank_tests.compute,
}

TOO_LONG_FOR_CSV = ("links", "histograms")
"""Tables that are not for reading."""


def _plan(settings: Settings) -> Sequence[Chain[AnalysisSpec]]:
    """Plan one item for each kind of analysis, and one for each arm's instruments and tank."""
    trials = tuple(trials_of(settings, "transfer"))
    depths = settings.grid.depths
    simulation = environments.simulation_spec(settings, *ENVIRONMENTS)
    penalty, held_out, seed = settings.ensemble.disagreement_penalty, settings.training.held_out, settings.seed

    def chain(identity: AnalysisId, spec: AnalysisSpec) -> Chain[AnalysisSpec]:
        weight = max(spec.n_rollouts, 1) * environments.relative_cost(settings, spec.environment)
        return Chain(identity, (1,), spec, weight=weight)

    n = len(trials)
    ensemble: EnvironmentName = "residual_slush" if settings.needs_ensemble else "true_slush"
    chains = [
        chain(AnalysisId(STATISTICS), StatisticsSpec(seed, trials, 0, "true_slush", settings.assessed_depth)),
        chain(AnalysisId(MEMBERS), MembersSpec(seed, (), 0, ensemble, held_out, simulation.physics, simulation.media)),
        chain(AnalysisId(MATRIX), MatrixSpec(seed, trials, n * len(depths), "true_slush", depths, simulation)),
        chain(AnalysisId(EXPLOITERS), ExploitersSpec(seed, trials, n, ensemble, simulation, penalty)),
    ]
    for arm, own in arms_of(trials).items():
        rollouts = len(own) * (1 + instruments.N_TRIES)
        spec = InstrumentsSpec(seed, tuple(own), rollouts, arm.environment, arm, held_out, simulation, penalty)
        chains.append(chain(AnalysisId(INSTRUMENTS, arm), spec))
        if settings.tank is not None:
            n_tank = settings.tank.n_steps(settings.physics.time_step)
            n_steps = n_tank + settings.rollout.n_settle
            n_rollouts = 1 + 2 * n_steps / (settings.rollout.n_settle + settings.rollout.n_measure)  # land, wet and dry
            rollouts = ceil(len(own) * n_rollouts)
            in_tank = TankSpec(seed, tuple(own), rollouts, "true_slush", arm, settings.tank, n_tank, simulation)
            chains.append(chain(AnalysisId(TANK, arm), in_tank))
    return chains


def _item(
    settings: Settings, chain: Chain[AnalysisSpec], index: int, previous: Manifest | None, upstream: Upstream
) -> Item[AnalysisItemSpec[AnalysisSpec]]:
    """Specify an analysis: the results that it reads, and why others are not there."""
    spec = chain.spec
    inputs = scores_inputs(spec.trials, upstream)
    if isinstance(spec, StatisticsSpec | ExploitersSpec):
        # In the order of their labels: resampling depends on the order of designs.
        for trial, (share,) in sorted(upstream["assess"].done.items(), key=lambda entry: entry[0].label):
            inputs[InputName(ASSESSED, trial)] = Input(share, (PREDICTIONS,))
    specified = AnalysisItemSpec(spec)
    if isinstance(spec, StatisticsSpec):
        failed = {trial.label: why for trial, why in upstream["transfer"].failed.items()}
        specified = AnalysisItemSpec(spec, failed=failed, not_assessed=_why_not_assessed(settings, upstream))
    elif not isinstance(spec, MatrixSpec | TankSpec):
        networks, why = _networks(settings, upstream, throws=not isinstance(spec, ExploitersSpec))
        inputs |= networks
        specified = AnalysisItemSpec(spec, no_networks=why)
    return Item(ANALYSE.name, ANALYSE.version, chain.label, specified, inputs, Execution(settings.work.engine))


def _networks(settings: Settings, upstream: Upstream, *, throws: bool) -> tuple[dict[InputName, Input], str]:
    """Return every member and what they learned from as inputs, or the reason why there are none."""
    if not settings.needs_ensemble:
        return {}, "no trial of this study needs networks"
    try:
        members = environments.member_inputs(settings, "residual_slush", 0, upstream)
        return {**members, **(data_set(upstream["collect"]) if throws else {})}, ""
    except MissingInputs as missing:
        return {}, str(missing)


def _why_not_assessed(settings: Settings, upstream: Upstream) -> str:
    """Say why there are no predictions; "" if there are."""
    if upstream["assess"].done:
        return ""
    if not settings.needs_ensemble:
        return "no trial of this study needs networks, so there are no predictions"
    failed = upstream["assess"].failed
    if failed:
        return "; ".join(f"{trial.label}: {why}" for trial, why in failed.items())
    return f"no trial evolved in {' or '.join(ASSESSED_ENVIRONMENTS)} at {settings.assessed_depth:g} m"


def compute(job: Job[AnalysisItemSpec[AnalysisSpec]], inputs: Inputs) -> Files:
    """Make the tables of one kind of analysis."""
    tables, reasons = _COMPUTE[type(job.spec.analysis)](job, inputs)
    files = {
        f"{name}.parquet": encode_table(columns, schema=name, version=_VERSION, producer=job.key)
        for name, columns in tables.items()
    }
    return {**files, REASONS: encode_json(reasons)}


def read_table(files: Files, name: str) -> Columns:
    """Read a table of an item by its name, such as "regressions"."""
    return decode_table(files[f"{name}.parquet"], schema=name, version=_VERSION, source=f"{name}.parquet")


def read_rows(files: Files | None, name: str, kind: type[AnyRow]) -> list[AnyRow]:
    """Read a table of an item as rows of the dataclass that it was written from; none where the item is missing.

    Args:
        files: files of the item.
        name: name of the table, such as "regressions".
        kind: the dataclass.
    """
    return rows_of(kind, read_table(files, name)) if files else []


def read_reasons(files: Files) -> Reasons:
    """Read what an item's tables lack, by table."""
    return dict(decode_json(files[REASONS], REASONS))


# -- what came of it -------------------------------------------------------------------------------------------------


def _summarise(settings: Settings, results: Results, store: Store) -> Summary:
    """Say how the study compares with the paper and what was imagined; give every table that a person may open."""
    found = {
        analysis: {
            name: store.read(done, name) for name in done.files if PurePosixPath(name).stem not in TOO_LONG_FOR_CSV
        }
        for analysis, (done,) in results.done.items()
    }
    lines: list[str] = []
    metrics: dict[str, float] = {}
    for kind, report_on in (
        (STATISTICS, _report_statistics),
        (MEMBERS, _report_members),
        (EXPLOITERS, _report_exploiters),
    ):
        if AnalysisId(kind) in found:
            more_lines, more_metrics = report_on(found[AnalysisId(kind)])
            lines += more_lines
            metrics |= more_metrics
    for arm in arms_of(trials_of(settings, "transfer")):
        if (files := found.get(AnalysisId(TANK, arm))) and settings.tank is not None:
            more_lines, more_metrics = _report_tank(arm, files, settings.tank)
            lines += more_lines
            metrics |= more_metrics
    for analysis, files in found.items():
        lines += [f"{analysis.label}: {table}: {why}" for table, why in read_reasons(files).items()]
    artifacts = {
        f"{analysis.label}/{name.removesuffix('.parquet')}.csv": csv_of(
            read_table(files, name.removesuffix(".parquet"))
        )
        for analysis, files in found.items()
        for name in files
        if name.endswith(".parquet")
    }
    return Summary(lines=lines, metrics=metrics, artifacts=artifacts, of_study=True)


Report = tuple[list[str], dict[str, float]]
"""Lines for the terminal, and metrics."""


def _report_statistics(files: Files) -> Report:
    """Set the paper's numbers beside this run's; ratios and regressions are what studies are compared by."""
    paper = read_table(files, "paper")
    names = ("what", "paper", "this_run", "interval", "verdict")
    rows = list(zip(*(paper[name].tolist() for name in names), strict=True))
    lines = [f"{'':<58} {'paper':>14} {'this run':>12} {'(95 %)':<18}"]
    lines += [
        f"{what:<58} {said:>14} {here:>12} {f'({interval})' if interval else '':<18} {verdict}"
        for what, said, here, interval, verdict in rows
        if not what.startswith(("Student", "the built robot"))
    ]
    tests = [verdict for what, *_, verdict in rows if what.startswith("Student")]
    counts = ", ".join(f"{tests.count(verdict)} {verdict}" for verdict in ("agrees", "differs", "not comparable"))
    lines.append(f"of the paper's {len(tests)} t tests: {counts}")
    metrics = {f"paper.n_{verdict}": float((paper["verdict"] == verdict).sum()) for verdict in ("agrees", "differs")}
    gaps = read_table(files, "attribution")
    recovered = ("evolved_in", "depth", "recovered_zero_shot", "recovered_adapted")
    for arm, depth, *ratios in zip(*(gaps[name].tolist() for name in recovered), strict=True):
        for name, ratio in zip(("zero_shot", "adapted"), ratios, strict=True):
            metrics[f"ratio_to_true_slush.{name}.{arm}.{depth:g}m"] = ratio
    accuracy = read_table(files, "regressions")
    together = {mean_less_deviations(0): "mean", mean_less_deviations(1): "mean_less_1_sd"}
    for predictor, r, slope in zip(*(accuracy[name].tolist() for name in ("name", "r", "slope")), strict=True):
        if predictor in together or predictor.startswith("member"):
            name = together.get(predictor, predictor.replace(" ", "-"))
            metrics |= {f"accuracy.r.{name}": r, f"accuracy.slope.{name}": slope}
    return lines, _finite(metrics)


def _report_members(files: Files) -> Report:
    thrust = read_table(files, "phantom_thrust")
    metrics = _finite({f"phantom_thrust.member-{k}": float(value) for k, value in enumerate(thrust["thrust"])})
    said = ", ".join(f"{value:+.4f}" for value in metrics.values())
    if metrics:
        metrics["phantom_thrust.rms"] = float(np.sqrt(np.mean(np.square(list(metrics.values())))))
    return ([f"phantom thrust of the members: {said} m/s²"] if metrics else []), metrics


def _report_exploiters(files: Files) -> Report:
    """Name the champion that lives most off the ensemble."""
    table = read_table(files, "exploiters")
    known = np.flatnonzero((table["kind"] == "champion") & np.isfinite(table["excess"]))
    if not len(known):
        return [], {}
    i = known[0]
    label = TrialId("transfer", table["environment"][i], table["depth"][i], table["trial"][i]).label
    worst = float(table["excess"][i])
    predicted, true = table["predicted"][i], table["true"][i]
    line = f"the champion with most imagined: {label}, predicted {predicted:z.1f} m, truly {true:z.1f} m"
    return [line], {"imagined.worst_champion": worst}


def _way(tank: Tank, crossed: bool, seconds: float, travelled: float, distance: float) -> str:
    """Say how far a robot came, as built; of the simulation's seconds and metres."""
    if crossed:
        return f"crosses in {tank.built_seconds(seconds):.0f} s"
    if not np.isfinite(travelled):
        return "diverged"
    if distance <= 0:
        return "is as long as the tank"
    travelled_cm, distance_cm = (100 * tank.scale * metres for metres in (travelled, distance))
    return f"comes {travelled_cm:z.1f} of {distance_cm:.1f} cm in {tank.seconds:g} s"


def _report_tank(of_arm: Arm, files: Files, of: Tank) -> Report:
    """Name the champion to build, and say how it fared in the tank."""
    table = read_table(files, "tank")
    (proposed,) = np.flatnonzero(table["proposed"]) if table["proposed"].any() else (None,)
    if proposed is None:
        return [], {}
    row = {name: column[proposed].item() for name, column in table.items()}
    in_slush, on_floor = (
        _way(of, row[f"{where}_crossed"], row[f"{where}_seconds"], row[f"{where}_travelled"], row[f"{where}_distance"])
        for where in ("wet", "dry")
    )
    label = AnalysisId(TANK, of_arm).label
    speed_mm = 1000 * of.built_speed(row["wet_speed"])
    lines = [
        f"{label}: to build: the champion of trial {row['trial']}, {row['zero_shot']:.2f} m in True Slush, the nearest "
        f"to the champions' mean of {np.nanmean(table['zero_shot']):.2f} m; on Dry Land {row['dry_land']:.2f} m",
        f"{label}: in the tank of {of.simulated_length:.1f} m x {of.simulated_depth:.2f} m of simulation it {in_slush} "
        f"({speed_mm:.0f} mm/s) as built; on the dry floor it {on_floor}",
        f"{label}: {int(table['wet_crossed'].sum())} of {len(table['trial'])} champions cross the tank, "
        f"{int(table['dry_crossed'].sum())} on its dry floor",
    ]
    arm = f"{of_arm.environment}.{of_arm.depth:g}m"
    names = ("zero_shot", "dry_land", "wet_crossed", "wet_seconds", "wet_speed", "dry_crossed", "dry_travelled")
    return lines, _finite({f"tank.{arm}.proposed.{name}": float(row[name]) for name in names})


def _finite(metrics: Mapping[str, float]) -> dict[str, float]:
    return {name: value for name, value in metrics.items() if np.isfinite(value)}


ANALYSE = Stage(
    name="analyse",
    version=_VERSION,
    unit="analyses",
    reads=lambda settings: ("collect", "train", "transfer", "assess"),
    plan=_plan,
    item=_item,
    compute=compute,
    summarise=_summarise,
)
