"""analyse: the results of a study as tables. Paper, "Results", and beyond it where the ensemble hallucinates.

Each chain is one work item. Its tables are Parquet; read them with :func:`read_rows` or :func:`read_table`. The schema
of a table is the name of its file without suffix. A missing number is NaN, a missing text is empty. An estimate X takes
four columns: X, X_low, X_high (95 %) and X_reason (why X or its interval is missing). Each work item also has
``reasons.json``, which gives by table why it is empty or incomplete; {} if nothing is missing. Lengths are in m unless
stated otherwise.

``statistics``, from scores and predictions alone:
    scores.parquet       a row per trial: environment, depth, trial, replicate (of the throws and networks that it
                         depends on; 0 for all trials without networks); where it evolved: fitness, predicted
                         (displacement, the mean over members), predicted_sd (σ over members); zero_shot, zero_shot_com,
                         zero_shot_reach (root minus centre of mass), adapted, adapted_com, adapted_reach, status ("ok"
                         or the reason why there are no scores)
    regressions.parquet  a row per predictor ("member 0", "mean", "mean - 1 sd", "min", ...): name, n, n_left_out,
                         n_resampled, and the estimates slope, intercept [m], r; learned_from; n_replicates (with
                         several, the intervals include the variance between them)
    histograms.parquet   a row per member, mean and mean - 1 sd: name, n_outside, edges (n_bins + 1 numbers, for both
                         axes), counts (n_bins² numbers: reshape to predicted by true)
    contrasts.parquet    a row per contrast and depth: a, b ("dry_land/adapted"), depth; for each side X = a, b: X_n,
                         X_n_left_out, X_n_replicates, the estimate X_mean, X_sd; for each test T = student, welch,
                         mann_whitney, clustered: T_statistic, T_p, T_reason; the estimates hedges_g and ratio; T_holm
                         (p over all rows). Of trials that share throws and networks, only the test clustered and the
                         intervals of X_mean and ratio take account
    attribution.parquet  a row per arm and depth: evolved_in, depth, n, n_best, and the estimates predicted, zero_shot,
                         adapted, best, best_adapted, hallucinated, gap, lost_to_controller, lost_to_body,
                         lost_to_body_equally_searched, controller_share, body_share, recovered_zero_shot,
                         recovered_adapted, recovered_adapted_equally_searched, recovered_zero_shot_of_adapted,
                         recovered_of_dry_land
    paper.parquet        a row per number of the paper: what, paper, source, this_run, verdict ("agrees", "differs",
                         "cannot tell", "not comparable"), why, value, interval (in words: 95 %, for a range those of
                         its ends), low, high (ends of the 95 % interval of value), p; value is the median for a range,
                         and the difference of the means for a t test; p is Student's, as the paper's, and the
                         interval is that of Holm's procedure, which judges all t tests together
    variance.parquet     a row per arm, depth and quantity ("predicted", "zero_shot", "adapted"): evolved_in, depth,
                         quantity, n, n_replicates; variances between (replicates: throws and training, which change
                         together) and within (evolution) [m²], and as deviations sd_between, sd_within; the estimate
                         share_between (between over the sum of both); NaN where there is one replicate, or one trial
                         in each
``members``, from networks and throws:
    phantom_thrust.parquet  a row per member: member, the estimate thrust [m/s²] (does not need True Slush)
    member_errors.parquet   on held-out throws, a row per member, component, band and immersion: member, component,
                            band, immersion, n_rows, bias, rmse, rms_true [m/s², m/s², rad/s²]
``transfer-matrix``, champions of every trial tested at every depth in True Slush:
    tests.parquet        environment, trained, trial, tested, displacement, com_displacement
    matrix.parquet       environment, trained, tested, mean, sd, n, relative (to the champions that evolved there)
``exploiters``, every champion and every assessed design, ordered by rank:
    exploiters.parquet   rank, kind ("champion", "assessed"), environment, depth, trial, generation and identity (-1
                         for a champion), predicted (mean over members, or by the champion's own network), true,
                         excess, disagreement (σ over members), ranked_by, reason, by_member (n_members numbers)
``instruments/<environment>/<depth>m``, the champions of one arm. Links and films show the best zero-shot champion, as
the page does; if none survives True Slush, the best champion where it evolved:
    champions.parquet    a row per champion: trial, best; home_displacement, home_com, home_reach where it evolved
                         (mean over members); slush_displacement, slush_com, slush_reach; winner's luck: claimed
                         (fitness where it evolved), again (mean of its repeats), the estimate loss, share_below,
                         n_diverged, n_tries
    champion_coverage.parquet  for champions that evolved with networks, where they evolved: a row per champion and
                         component of the state, and one for "all": trial, component, n (states), share_outside (share
                         of them outside the throws, chiefly because of the component), low, high (5th and 95th
                         percentile of the component there), median, far (median and 95th percentile of the distance
                         of all states from the throws [deviations of the arm's states]; the same for all components)
    links.parquet        a row per film, step and link, in that order: seen_in ("true_slush"; then the environment where
                         it evolved, if that is another one), step, link, disagreement [m/s²], novelty (1 is typical),
                         distance [standard deviations], component (of SPACE; "" if unknown), departure and thrust
                         (n_members numbers each, m/s²)
    films.parquet        a row per film in links: seen_in, member (whose environment it is, -1 if none; for an ensemble,
                         the member whose prediction is the median), trial, displacement, disagreement (mean),
                         share_novel (share with novelty above 1, which half of new throws have), thrust (n_members
                         numbers: mean departure along x)
    member_errors.parquet   as for ``members``, along the rollouts of all champions of the arm in True Slush
``tank/<environment>/<depth>m``, the champions of one arm and which to build, if the settings have a tank:
    tank.parquet         a row per champion: trial, proposed; zero_shot, dry_land, dry_land_com; for X = wet, dry,
                         dry_servo (the filled and the drained tank, and the drained one with the servo's torque at
                         scale), the first trial: X_length, X_height [m], X_misfit (why the robot does not fit into the
                         tank; "" if it fits), X_distance, X_travelled [m], X_crossed, X_seconds, X_speed, all in units
                         of the simulation; motor_torque, servo_torque (limits of the motors in X = wet, dry and in
                         dry_servo [N·m]); of all trials: X_trials_n, X_trials_n_crossed,
                         X_trials_n_crossed_at_kept_frequencies, X_trials_n_immobile
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import ceil
from pathlib import PurePosixPath
from typing import Any

from pipeline.config.settings import Settings
from pipeline.stages import environments
from pipeline.stages.analyses import champions, instruments, specs, statistics, tank_tests
from pipeline.stages.analyses.analysis_tables import ANALYSIS_VERSION, Reasons, Tables, encode, read_reasons, read_table
from pipeline.stages.analyses.summary import highlights, wrapped
from pipeline.stages.assess import ASSESSED, ASSESSED_ENVIRONMENTS, PREDICTIONS
from pipeline.stages.collect import throws_inputs
from pipeline.stages.data_sets import data_set_of, main_data_set
from pipeline.stages.part import PartId
from pipeline.stages.transfer import scores_inputs
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.store.tables import csv_of
from pipeline.workflow.identity import InputName, arms_of, trials_of
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
from tasks.world import EnvironmentName

_COMPUTE: Mapping[type[specs.AnalysisSpec], Callable[[Job[Any], Inputs], tuple[Tables, Reasons]]] = {
    specs.StatisticsSpec: statistics.compute,
    specs.MembersSpec: instruments.compute_members,
    specs.MatrixSpec: champions.compute_matrix,
    specs.ExploitersSpec: champions.compute_exploiters,
    specs.InstrumentsSpec: instruments.compute_arm,
    specs.TankSpec: tank_tests.compute,
}

_NOT_AS_CSV = ("links", "histograms")  # tables that are too long to read


def _plan(settings: Settings) -> Sequence[Chain[specs.AnalysisSpec]]:
    """Plan one item for each kind of analysis, and one for each arm's instruments and tank."""
    trials = tuple(trials_of(settings, "transfer"))
    depths, rollout, tank = settings.grid.depths, settings.rollout, settings.tank
    simulation = environments.simulation_spec(settings, "true_slush", *(arm.environment for arm in arms_of(trials)))
    penalty, held_out, seed = settings.ensemble.disagreement_penalty, settings.training.held_out, settings.seed
    deviation = settings.ensemble.deviation
    chains: list[Chain[specs.AnalysisSpec]] = []

    def plan(
        part: PartId, spec: specs.AnalysisSpec, n_rollouts: int, environment: EnvironmentName = "true_slush"
    ) -> None:
        weight = max(n_rollouts, 1) * environments.relative_cost(settings, environment)
        chains.append(Chain(part, (1,), spec, weight=weight))

    ensemble: EnvironmentName = "residual_slush" if settings.needs_ensemble else "true_slush"
    groups, assessed_depth = settings.throw_groups, settings.assessed_depth
    statistics = specs.StatisticsSpec(seed, trials, simulation, assessed_depth, groups, deviation=deviation)
    plan(PartId(specs.STATISTICS), statistics, 0)
    plan(PartId(specs.MEMBERS), specs.MembersSpec(seed, (), simulation, held_out), 0, ensemble)
    plan(PartId(specs.MATRIX), specs.MatrixSpec(seed, trials, simulation, depths), len(trials) * len(depths))
    exploiters = specs.ExploitersSpec(seed, trials, simulation, deviation=deviation)
    plan(PartId(specs.EXPLOITERS), exploiters, len(trials), ensemble)
    for arm, of_arm in arms_of(trials).items():
        own, n = tuple(of_arm), len(of_arm)
        spec = specs.InstrumentsSpec(
            seed,
            own,
            simulation,
            arm,
            held_out,
            penalty,
            objective=settings.evolution.objective,
            objective_depths=settings.objective_depths,
            deviation=deviation,
        )
        n_depths = len({arm.depth, *settings.objective_depths})
        plan(PartId(specs.INSTRUMENTS, arm), spec, n * (1 + instruments.N_TRIES * n_depths), arm.environment)
        if tank is not None:
            n_tank = tank.n_steps(settings.physics.time_step)
            # One rollout on Dry Land, and several in the filled tank and, with either torque, in the drained one.
            n_rollouts = 1 + 3 * tank.n_trials * (n_tank + rollout.n_settle) / (rollout.n_settle + rollout.n_measure)
            plan(
                PartId(specs.TANK, arm), specs.TankSpec(seed, own, simulation, arm, tank, n_tank), ceil(n * n_rollouts)
            )
    return chains


def _item(
    settings: Settings, chain: Chain[specs.AnalysisSpec], index: int, previous: Manifest | None, upstream: Upstream
) -> Item[specs.AnalysisSpec]:
    """Specify an analysis: its inputs, and why others are missing."""
    spec = chain.spec
    inputs = scores_inputs(spec.trials, upstream)
    if isinstance(spec, specs.StatisticsSpec | specs.ExploitersSpec):
        # In the order of their labels: resampling depends on the order of designs.
        for trial, (share,) in sorted(upstream["assess"].done.items(), key=lambda entry: entry[0].label):
            inputs[InputName(ASSESSED, trial)] = Input(share, (PREDICTIONS,))
    if isinstance(spec, specs.StatisticsSpec):
        failed = {trial.label: str(why) for trial, why in upstream["transfer"].failed.items()}
        spec = replace(spec, failed=failed, not_assessed=_why_not_assessed(settings, upstream))
    elif not isinstance(spec, specs.MatrixSpec | specs.TankSpec):
        networks, why = _networks(settings, upstream, spec)
        inputs |= networks
        spec = replace(spec, no_networks=why)
    return Item(ANALYSE.name, ANALYSE.version, chain.label, spec, inputs, Execution(settings.work.engine))


def _networks(settings: Settings, upstream: Upstream, spec: specs.AnalysisSpec) -> tuple[dict[InputName, Input], str]:
    """Return the networks that an analysis uses, and the throws that they learned from, or why they are missing.

    Args:
        settings: the study's settings.
        upstream: results of the stages before.
        spec: the analysis.
    """
    if not settings.needs_ensemble:
        return {}, "no trial of this study needs networks"
    main = main_data_set(settings)
    try:
        if isinstance(spec, specs.ExploitersSpec):
            return environments.networks_inputs(settings, spec.trials, upstream), ""
        if not isinstance(spec, specs.InstrumentsSpec):
            networks, used = environments.ensemble_inputs(settings, main, upstream), [main]
        else:
            networks = environments.networks_inputs(settings, spec.trials, upstream)
            used = list(dict.fromkeys(data_set_of(trial, main.group) for trial in spec.trials))
        throws = [throws_inputs(upstream["collect"], data_set) for data_set in used]
        return {name: given for inputs in (networks, *throws) for name, given in inputs.items()}, ""
    except MissingInputs as missing:
        return {}, str(missing)


def _why_not_assessed(settings: Settings, upstream: Upstream) -> str:
    """Return why there are no predictions; "" if there are some."""
    if upstream["assess"].done:
        return ""
    if not settings.needs_ensemble:
        return "no trial of this study needs networks, so there are no predictions"
    failed = upstream["assess"].failed
    if failed:
        return "; ".join(f"{trial.label}: {why}" for trial, why in failed.items())
    return f"no trial evolved in {' or '.join(ASSESSED_ENVIRONMENTS)} at {settings.assessed_depth:g} m"


def _compute(job: Job[specs.AnalysisSpec], inputs: Inputs) -> Files:
    tables, reasons = _COMPUTE[type(job.spec)](job, inputs)
    return encode(tables, reasons, producer=job.key)


def _summarise(settings: Settings, results: Results, store: Store) -> Summary:
    """Report the comparison with the paper and model exploitation; offer every table of readable size as CSV."""
    found = {
        analysis: {name: store.read(done, name) for name in done.files if PurePosixPath(name).stem not in _NOT_AS_CSV}
        for analysis, (done,) in results.done.items()
    }
    lines, metrics = highlights(found, settings.tank)
    for analysis, files in found.items():
        reasons = [f"{analysis.label}: {table}: {why}" for table, why in read_reasons(files).items()]
        lines += [part for reason in reasons for part in wrapped(reason)]
    artifacts = {
        f"{analysis.label}/{PurePosixPath(name).stem}.csv": csv_of(read_table(files, PurePosixPath(name).stem))
        for analysis, files in found.items()
        for name in files
        if name.endswith(".parquet")
    }
    return Summary(lines=lines, metrics=metrics, artifacts=artifacts, of_study=True)


ANALYSE = Stage(
    name="analyse",
    version=ANALYSIS_VERSION,
    unit="analyses",
    reads=lambda settings: ("collect", "train", "transfer", "assess"),
    plan=_plan,
    item=_item,
    compute=_compute,
    summarise=_summarise,
)
