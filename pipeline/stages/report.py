"""report: the page of a study, its figures as SVG and PNG, and its films as GIF and MP4."""

from collections.abc import Collection, Container, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import yaml

from pipeline.config.settings import RESIDUAL_ENVIRONMENTS, Settings, WorkSettings
from pipeline.report import wording
from pipeline.report.camera import FILM_FPS
from pipeline.report.data import ROBOT_PREFIX, Draws, StudyReport, TrialResult, robot_address
from pipeline.report.downloads import tables_of
from pipeline.report.moving import exemplars
from pipeline.report.replay import Replay
from pipeline.stages import divergence, environments, segments
from pipeline.stages.analyses.champions import champions
from pipeline.stages.analyses.filmed_rollouts import best_of
from pipeline.stages.assess import ASSESSED, PREDICTIONS, AssessmentId, read_predictions
from pipeline.stages.collect import throws_inputs
from pipeline.stages.data_sets import DataSetId, NetworkId, ensemble_ids, main_data_set
from pipeline.stages.environments import SimulationSpec
from pipeline.stages.part import PartId
from pipeline.stages.pilot import pilots_inputs
from pipeline.stages.proposed_design import ANALYSED, PROPOSED, proposal_files, proposed, tank_replays
from pipeline.stages.report_findings import HISTORIES, findings
from pipeline.stages.report_replays import EXPLOITERS, TOGETHER, replays_of, replays_of_page
from pipeline.stages.report_robots import robot_files
from pipeline.stages.train import MEMBER_ERRORS, read_errors
from pipeline.stages.transfer import SCORE, SCORED, scores_inputs
from pipeline.stages.trial_scores import decode_scores
from pipeline.store.encoding import decode_json, encode_json
from pipeline.store.manifest import Manifest
from pipeline.store.provenance import environment as provenance
from pipeline.store.store import Store
from pipeline.store.tables import Columns, rows_of
from pipeline.workflow.identity import Arm, ChainId, InputName, TrialId, deepest_first, trials_of
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
from tasks.analysis.member_error import MemberError
from tasks.evolution import OPERATORS
from tasks.residual.error_report import ErrorRow
from tasks.world import ENVIRONMENTS

PAGE = "index.html"  # the page's file
_PAGE_ID = PartId(PAGE)
TRAINED, EVOLUTION, ADAPTATION = "trained", "evolution", "adaptation"
"""Roles of the inputs that are members' errors, curves of trials, and curves of their adaptations."""

_PICTURES_OF_PAGE = 4000  # approximate cost of the page, as pictures of a film


@dataclass(frozen=True)
class PageItemSpec:
    """The page of what is done."""

    settings: Settings  # those of the study without how its work is divided
    failed: tuple[str, ...]
    not_possible: tuple[str, ...]
    digests: tuple[tuple[str, str, str], ...]  # stage, label and digest of every chain that is done
    made_with: Mapping[str, str]


@dataclass(frozen=True)
class FilmsSpec:
    """The films of the champions of some trials."""

    simulation: SimulationSpec
    trials: tuple[TrialId, ...]
    together: bool
    listing: str


def _reads(settings: Settings) -> tuple[str, ...]:
    rest = ("evolve", "transfer", "assess", "analyse")
    return ("collect", "train", "pilot", *rest) if settings.needs_ensemble else rest


def _plan(settings: Settings) -> Sequence[Chain[Settings | FilmsSpec]]:
    """Plan the page, the films of every arm, and the film of two robots."""
    trials = trials_of(settings, "transfer")
    measured_seconds = settings.rollout.n_measure * settings.physics.time_step
    pictures = measured_seconds * FILM_FPS
    deepest = max(settings.grid.depths)

    def films(identity: PartId, filmed: Sequence[TrialId], n_films: int) -> Chain[Settings | FilmsSpec]:
        listing = identity.label.replace("/", "-").replace(".", "_") + ".json"
        simulation = environments.simulation_spec(settings, "true_slush", *(trial.environment for trial in filmed))
        spec = FilmsSpec(simulation, tuple(filmed), identity.arm is None, listing)
        return Chain(identity, (n_films * pictures,), spec)

    whole = settings.model_copy(update={"work": WorkSettings()})
    chains: list[Chain[Settings | FilmsSpec]] = [Chain(_PAGE_ID, (_PICTURES_OF_PAGE,), whole)]
    for arm, own in deepest_first(trials).items():
        chains.append(films(PartId("films", arm), own, 1 if arm.environment == "true_slush" else 2))
    arms = [Arm("residual_slush", deepest), Arm("dry_land", deepest)]
    both = [trial for arm in arms for trial in trials if trial.arm == arm]
    return [*chains, films(PartId("films/together"), both or [trial for trial in trials if trial.depth == deepest], 2)]


def _item(
    settings: Settings, chain: Chain[Settings | FilmsSpec], index: int, previous: Manifest | None, upstream: Upstream
) -> Item[PageItemSpec | FilmsSpec]:
    """Specify films by their champions and environments; the page by the small files of all that is done, too."""
    execution = Execution(settings.work.engine)
    if isinstance(chain.spec, FilmsSpec):
        inputs = _film_inputs(settings, chain.spec.trials, upstream)
        return Item(REPORT.name, REPORT.version, chain.label, chain.spec, inputs, execution)
    inputs = _film_inputs(settings, trials_of(settings, "transfer"), upstream)
    trained = upstream["train"].done
    members = [member for member in _main_members(settings) if member in trained]
    inputs |= {InputName(TRAINED, member): Input(trained[member][0], (MEMBER_ERRORS,)) for member in members}
    for trial, evolved in upstream["evolve"].done.items():
        for number, segment in enumerate(evolved):
            inputs[InputName(EVOLUTION, trial, number)] = Input(segment, (segments.CURVE,))
    for trial, (*adaptation, _) in upstream["transfer"].done.items():
        for number, segment in enumerate(adaptation):
            inputs[InputName(ADAPTATION, trial, number)] = Input(segment, (segments.CURVE,))
    for trial, (share,) in upstream["assess"].done.items():
        inputs[InputName(ASSESSED, trial)] = Input(share, (PREDICTIONS,))
    for identity, (analysis,) in upstream["analyse"].done.items():
        inputs[InputName(ANALYSED, identity)] = Input(analysis, tuple(analysis.files))
    inputs |= pilots_inputs(upstream) if "pilot" in upstream else {}
    if settings.needs_ensemble:
        with suppress(MissingInputs):  # the figure of the data set then gives a reason
            inputs |= throws_inputs(upstream["collect"], main_data_set(settings))
    if (family := _family_trial(settings, upstream["evolve"].done)) is not None:
        for number, segment in enumerate(upstream["evolve"].done[family]):
            inputs[InputName(HISTORIES, family, number)] = Input(segment, (segments.HISTORY,))
    lost = [
        (why.tried, f"{name}: {identity.label} {why}")
        for name in upstream
        for identity, why in upstream[name].failed.items()
    ]
    spec = PageItemSpec(
        chain.spec,
        failed=tuple(words for tried, words in lost if tried),
        not_possible=tuple(words for tried, words in lost if not tried),
        digests=tuple(
            (name, identity.label, manifests[-1].digest)
            for name in upstream
            for identity, manifests in upstream[name].done.items()
            if name in REPORT.reads(settings)
        ),
        made_with=dict(provenance()),
    )
    return Item(REPORT.name, REPORT.version, chain.label, spec, inputs, execution)


def _film_inputs(settings: Settings, trials: Sequence[TrialId], upstream: Upstream) -> dict[InputName, Input]:
    inputs = scores_inputs(trials, upstream)
    if any(trial.environment in RESIDUAL_ENVIRONMENTS for trial in trials):
        with suppress(MissingInputs):  # where a member is missing there are no residual environments to film
            inputs |= environments.networks_inputs(settings, trials, upstream)
    return inputs


def _main_members(settings: Settings) -> list[NetworkId]:
    return ensemble_ids(settings, main_data_set(settings)) if settings.needs_ensemble else []


def _family_trial(settings: Settings, evolved: Container[object]) -> TrialId | None:
    """Return the trial whose champion's family is shown: the first that is done where residuals matter most."""
    trials = trials_of(settings, "evolve")
    done = [trial for trial in trials if trial in evolved]
    return min(done, key=lambda trial: (trial.environment != "residual_slush", -trial.depth, trial.index), default=None)


def _compute(job: Job[PageItemSpec | FilmsSpec], inputs: Inputs) -> Files:
    spec = job.spec
    if isinstance(spec, FilmsSpec):
        return _films(spec, job.execution, inputs)
    return _page(spec, job.execution, inputs)


def _films(spec: FilmsSpec, execution: Execution, inputs: Inputs) -> Files:
    """Make a GIF and an MP4 of each replay, or of the two in True Slush together, and a listing of the films."""
    from pipeline.report.films import render_films  # Matplotlib takes seconds to import, and only this stage needs it

    replays = replays_of(spec.simulation, spec.trials, execution, inputs)
    named = {replay.film: [replay] for replay in replays}
    if spec.together:
        named = {TOGETHER: shown} if (shown := exemplars(replays)) else {}
    files: dict[str, bytes] = {}
    for name, shown in named.items():
        files[f"{name}.gif"], files[f"{name}.mp4"] = render_films(shown)
    entrants = champions(spec.trials, inputs)
    filmed = None if spec.together or not entrants else entrants[best_of(entrants)[0]].trial.index
    listed = {
        name: {"shown": [f"{one.title}, in {one.seen_in}, {one.depth:g} m" for one in shown], "trial": filmed}
        for name, shown in named.items()
    }
    return {**files, spec.listing: encode_json(listed)}


def _page(spec: PageItemSpec, execution: Execution, inputs: Inputs) -> Files:
    """Draw the page and its figures."""
    from pipeline.report.drawing import Drawing
    from pipeline.report.figures import draw_all
    from pipeline.report.page import render_page, render_robot

    settings = spec.settings
    trials, rows = trials_of(settings, "transfer"), proposed(settings, inputs)
    replays = replays_of_page(environments.simulation_spec(settings, *ENVIRONMENTS), trials, execution, inputs)
    in_tank = [film for row in rows for film in tank_replays(settings, row, inputs, execution.engine)]
    report = _report(spec, inputs, [*replays, *in_tank])
    drawings = draw_all(report)
    files = {PAGE: render_page(report, drawings).encode(), **tables_of(report), **proposal_files(rows, inputs)}
    files |= robot_files(inputs, trials)
    for one in replays:
        if one.in_true_slush and one.group != EXPLOITERS:
            words = f"{one.seen_in}, {one.depth:g} m deep: {wording.number(one.displacement)} m in {one.duration:.0f} s"
            files[f"{one.robot}.html"] = render_robot(one, [words]).encode()
    for drawing in drawings.values():
        if isinstance(drawing, Drawing):
            files |= {f"{drawing.name}.svg": drawing.svg, f"{drawing.name}.png": drawing.png}
    return files


def _report(spec: PageItemSpec, inputs: Inputs, replays: Sequence[Replay]) -> StudyReport:
    settings, evolved = spec.settings, _curves(EVOLUTION, inputs)
    trials = trials_of(settings, "transfer")
    family = _family_trial(settings, {name.chain for name in inputs if name.role == HISTORIES})
    return StudyReport(
        name=settings.name,
        title=f"Robots evolved for slush: {settings.name}",
        created_with=spec.made_with,
        settings_yaml=yaml.safe_dump(settings.model_dump(mode="json", exclude={"work"}), sort_keys=False),
        trials=[result for trial in trials if (result := _trial_result(trial, inputs, evolved)) is not None],
        residual_errors=_residual_errors(inputs),
        replays=replays,
        findings=findings(inputs, settings, family),
        draws=_draws(evolved.values()),
        environments=tuple(dict.fromkeys(trial.environment for trial in trials)),
        depths=settings.grid.depths,
        trains_networks=settings.needs_ensemble,
        measured_seconds=settings.rollout.n_measure * settings.physics.time_step,
        digests=spec.digests,
        failed=spec.failed,
        not_possible=spec.not_possible,
        diverged=_diverged(settings, inputs, evolved),
    )


def read_report(settings: Settings, upstream: Upstream, store: Store) -> StudyReport:
    """Return what the page shows of a study, without its replays.

    Args:
        settings: the study's settings.
        upstream: results of the stages before.
        store: where they are.
    """
    page = next(chain for chain in _plan(settings) if chain.identity == _PAGE_ID)
    item = _item(settings, page, 0, None, upstream)
    assert isinstance(item.spec, PageItemSpec)
    inputs = {
        name: {file: store.read(source.manifest, file) for file in source.files} for name, source in item.inputs.items()
    }
    return _report(item.spec, inputs, [])


def _curves(role: str, inputs: Inputs) -> dict[ChainId, Columns]:
    """Join the curves of each trial's segments."""
    parts: dict[ChainId, dict[str, bytes]] = {}
    for name, files in inputs.items():
        if name.role == role and name.chain:
            parts.setdefault(name.chain, {})[name.label] = files[segments.CURVE]
    return {trial: segments.join_curves(curves) for trial, curves in parts.items()}


def _trial_result(trial: TrialId, inputs: Inputs, evolved: Mapping[ChainId, Columns]) -> TrialResult | None:
    """Return the curve and the scores of a trial; None if it failed. A champion that diverged has NaN for scores."""
    scored = inputs.get(InputName(SCORED, trial))
    if scored is None:
        return None
    curve = evolved.get(trial.in_stage("evolve"), {"best_fitness": np.empty(0)})["best_fitness"]
    arm = trial.environment, trial.depth
    scores = decode_scores(scored[SCORE], trial.label)
    if scores is None:
        return TrialResult(*arm, trial.index, predicted=np.nan, curve=curve)
    return TrialResult(*arm, trial.index, **vars(scores), curve=curve)


def _draws(curves: Collection[Columns]) -> list[Draws]:
    """Sum the draws of all trials by operator, for operators that rejected some."""
    totals = [
        Draws(
            operator,
            n_drawn=sum(int(curve[segments.drawn_column(operator)].sum()) for curve in curves),
            n_rejected=sum(int(curve[segments.rejected_column(operator)].sum()) for curve in curves),
        )
        for operator in OPERATORS
    ]
    return [total for total in totals if total.n_rejected]


def _diverged(settings: Settings, inputs: Inputs, evolved: Mapping[ChainId, Columns]) -> list[str]:
    """List what diverged, by trial."""
    adapted = _curves(ADAPTATION, inputs)
    found = []
    for trial in trials_of(settings, "transfer"):
        label = trial.label
        if (curve := evolved.get(trial.in_stage("evolve"))) is not None:
            found.append((f"evolve: {label}", divergence.in_trial(curve)))
        if (scored := inputs.get(InputName(SCORED, trial))) is not None:
            scores = decode_scores(scored[SCORE], label)
            found.append((f"transfer: {label}", divergence.in_transfer(scores, adapted.get(trial))))
        for group in settings.throw_groups:
            assessment = AssessmentId(trial.in_stage("assess"), DataSetId(group, trial.replicate))
            if (share := inputs.get(InputName(ASSESSED, assessment))) is not None:
                found.append((f"assess: {assessment.label}", divergence.in_assessment(read_predictions([share]))))
    return [f"{where}: {what}" for where, what in found if what is not None]


def _residual_errors(inputs: Inputs) -> list[MemberError]:
    """Return the errors of every member by component and band of speed."""
    rows = []
    members = [files for name, files in inputs.items() if name.role == TRAINED]
    for member, files in enumerate(members):
        errors = rows_of(ErrorRow, read_errors(files[MEMBER_ERRORS], f"errors of member {member}"))
        for row in errors:
            if row.band != "all" and np.isfinite(row.rmse):
                truth = row.rmse / row.relative_error if row.relative_error > 0 else 0.0  # the ratio may be NaN
                errors_of = (row.component, row.band, "all", row.n_rows, row.bias, row.rmse, truth)
                rows.append(MemberError(member, *errors_of))
    return rows


def _summarise(settings: Settings, results: Results, store: Store) -> Summary:
    """Export the page, the figures and the films to the folder of the study."""
    files = {name: store.read(done, name) for (done,) in results.done.values() for name in done.files}
    folder = store.export(settings.name, files)
    no_page = f"no page: {results.failed.get(_PAGE_ID, 'it has not been made yet')}"
    # A GIF is ten times as large as an MP4, so MLflow gets only one GIF. Champions are with their trials.
    artifacts = {
        name: data
        for name, data in files.items()
        if name == f"{TOGETHER}.gif" or not (name.endswith(".gif") or name.startswith(("films-", ROBOT_PREFIX)))
    }
    lines = [f"{folder / PAGE}" if PAGE in files else no_page]
    lines += [f"{folder / name}: a robot to build" for name in files if name.startswith(PROPOSED)]
    return Summary(lines=lines, artifacts=artifacts, films=_films_of_trials(settings, results, files), of_study=True)


def _films_of_trials(settings: Settings, results: Results, files: Files) -> dict[TrialId, dict[str, bytes]]:
    """Select for each trial of the stage evolve the replay of its champion, and the MP4s if it was filmed."""
    films: dict[TrialId, dict[str, bytes]] = {}
    for trial in trials_of(settings, "evolve"):
        replay = f"{robot_address(trial.environment, trial.depth, trial.index)}.html"
        if replay in files:
            films[trial] = {"replay.html": files[replay]}
    for part, (done,) in results.done.items():
        if isinstance(part, PartId) and part.arm is not None:
            (listing,) = (name for name in done.files if name.endswith(".json"))
            for film, what in decode_json(files[listing], listing).items():
                trial = TrialId("evolve", part.arm.environment, part.arm.depth, what["trial"])
                films.setdefault(trial, {})[f"{film}.mp4"] = files[f"{film}.mp4"]
    return films


REPORT = Stage(
    name="report",
    version=17,
    unit="pictures",
    reads=_reads,
    plan=_plan,
    item=_item,
    compute=_compute,
    summarise=_summarise,
)
