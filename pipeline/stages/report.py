"""report: the page of a study, its figures and tables as files, and the film of its first screen."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from pipeline.config.settings import Settings, WorkSettings
from pipeline.report.network_figures import ThrowPaths
from pipeline.report.page import StudyPage, heroes, robot_address
from pipeline.report.render import tables_of, typeset
from pipeline.report.replay import FILM_FPS
from pipeline.report.transfer_figures import Curves
from pipeline.stages import divergence, segments
from pipeline.stages.analyse import read_tables
from pipeline.stages.assess import ASSESSED, AssessmentId, read_predictions
from pipeline.stages.collect import read_transitions, throws_among, throws_inputs
from pipeline.stages.data_sets import DataSetId, data_sets
from pipeline.stages.replays import best_replays, elite_replays, replays_of
from pipeline.stages.study_data import DataSpec, StudyFiles, data_inputs, data_spec
from pipeline.stages.transfer import SCORED
from pipeline.stages.trial_scores import SCORE, decode_scores
from pipeline.store.design_file import design_json
from pipeline.store.encoding import encode_json
from pipeline.store.manifest import Manifest
from pipeline.store.provenance import environment as provenance
from pipeline.store.store import Store
from pipeline.store.tables import Columns
from pipeline.workflow.identity import ChainId, InputName, OutputId, TrialId, trials_of
from pipeline.workflow.stage import (
    Chain,
    Execution,
    Files,
    Input,
    Inputs,
    Item,
    MissingInputs,
    Results,
    Sources,
    Stage,
    Summary,
    Upstream,
)
from tasks.analysis.scores import Champion

PAGE = "index.html"  # the page's file
FILM = "replay"  # name of the film of the first screen, without suffix
PROPOSED = "proposed-"  # prefix of the design files of champions that are proposed for building
_PAGE_ID, _FILM_ID = OutputId(PAGE), OutputId("film")
EVOLUTION, ADAPTATION, ANALYSED = "evolution", "adaptation", "analysed"
"""Roles of the inputs that are curves of trials, curves of their adaptations, and tables of analyses."""

_PICTURES_OF_PAGE = 4000  # approximate cost of the page, as pictures of a film


@dataclass(frozen=True)
class PageItemSpec:
    """The page of what is done."""

    settings: Settings  # those of the study without how its work is divided
    failed: tuple[str, ...]
    not_possible: tuple[str, ...]
    digests: tuple[tuple[str, str, str], ...]  # stage, label and digest of every chain that is done
    made_with: Mapping[str, str]


def _reads(settings: Settings) -> tuple[str, ...]:
    rest = ("evolve", "transfer", "assess", "analyse")
    return ("collect", "train", *rest) if settings.needs_ensemble else rest


def _plan(settings: Settings) -> Sequence[Chain[Settings | DataSpec]]:
    """Plan the page, and the film of its first screen."""
    deepest = [trial for trial in trials_of(settings, "transfer") if trial.depth == max(settings.grid.depths)]
    pictures = 2 * settings.rollout.n_measure * settings.physics.time_step * FILM_FPS
    whole = settings.model_copy(update={"work": WorkSettings()})
    return [Chain(_PAGE_ID, (_PICTURES_OF_PAGE,), whole), Chain(_FILM_ID, (pictures,), data_spec(settings, deepest))]


def _item(
    settings: Settings, chain: Chain[Settings | DataSpec], index: int, previous: Manifest | None, upstream: Upstream
) -> Item[PageItemSpec | DataSpec]:
    """Specify the film by champions and environments; the page by the small files of all that is done, too."""
    execution = Execution(settings.work.engine)
    if isinstance(chain.spec, DataSpec):
        inputs = _data_inputs(settings, chain.spec.trials, upstream)
        return Item(REPORT.name, REPORT.version, chain.label, chain.spec, inputs, execution)
    inputs = _data_inputs(settings, trials_of(settings, "transfer"), upstream)
    if settings.evolution.search == "map_elites":
        inputs |= data_inputs(settings, trials_of(settings, "transfer"), ("evolve",), upstream)
    for trial, evolved in upstream["evolve"].done.items():
        for number, segment in enumerate(evolved):
            inputs[InputName(EVOLUTION, trial, number)] = Input(segment, (segments.CURVE,))
    for trial, (*adaptation, _) in upstream["transfer"].done.items():
        for number, segment in enumerate(adaptation):
            inputs[InputName(ADAPTATION, trial, number)] = Input(segment, (segments.CURVE,))
    for identity, (analysis,) in upstream["analyse"].done.items():
        inputs[InputName(ANALYSED, identity)] = Input(analysis, tuple(analysis.files))
    if settings.needs_ensemble:
        with suppress(MissingInputs):
            inputs |= throws_inputs(upstream["collect"], data_sets(settings)[0])
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


def _data_inputs(settings: Settings, trials: Sequence[TrialId], upstream: Upstream) -> Sources:
    """Return scores, predictions and networks; where a network is missing there are no residual environments."""
    inputs = data_inputs(settings, trials, ("assess",), upstream)
    with suppress(MissingInputs):
        inputs |= data_inputs(settings, trials, ("train",), upstream) if settings.needs_ensemble else {}
    return inputs


def _compute(item: Item[PageItemSpec | DataSpec], inputs: Inputs) -> Files:
    spec = item.spec
    if isinstance(spec, DataSpec):
        return _film(StudyFiles(spec, item.execution, inputs))
    return _page(spec, item.execution, inputs)


def _film(study: StudyFiles) -> Files:
    """Make a GIF and an MP4 of the two robots of the first screen."""
    from pipeline.report.films import (
        render_gif,
        render_mp4,
    )  # Matplotlib takes seconds to import, and only this stage needs it

    shown = [replay for _, replay in heroes(best_replays(study))]
    if not shown:
        return {f"{FILM}.json": encode_json({"shown": []})}
    listed = [f"{one.title}, in {one.seen_in}, {one.depth:g} m" for one in shown]
    return {
        f"{FILM}.gif": render_gif(shown),
        f"{FILM}.mp4": render_mp4(shown),
        f"{FILM}.json": encode_json({"shown": listed}),
    }


def _page(spec: PageItemSpec, execution: Execution, inputs: Inputs) -> Files:
    """Draw the page and its figures, and write its tables and the design files of champions."""
    from pipeline.report.page import draw_all, render_page, render_robot

    settings = spec.settings
    study = StudyFiles(data_spec(settings, trials_of(settings, "transfer")), execution, inputs)
    elites = elite_replays(study)
    page = replace(_study_page(spec, inputs, study), replays=[*replays_of(study), *(replay for _, replay in elites)])
    drawings = draw_all(page)
    files = {PAGE: render_page(page, drawings).encode(), **tables_of(page.tables, settings.evolution.maximised)}
    for champion in study.champions:
        address = robot_address(champion.environment, champion.depth, champion.trial)
        files[f"{address}.json"] = design_json(champion.design)
    files |= {f"{replay.robot}.json": design_json(design) for design, replay in elites}
    for champion in _proposed(page, study):
        name = f"{PROPOSED}{champion.environment}-{champion.depth:g}m".replace(".", "_")  # one dot in a file name
        files[f"{name}.json"] = design_json(champion.design)
    for one in page.replays:
        if one.in_target and one.robot:
            words = f"{one.seen_in}, {one.depth:g} m deep: {one.displacement:z.1f} m in {one.duration:.0f} s"
            files[f"{one.robot}.html"] = render_robot(one, [typeset(words)]).encode()
    for drawing in drawings.values():
        files |= {f"{drawing.name}.svg": drawing.svg, f"{drawing.name}.png": drawing.png}
    return files


def _study_page(spec: PageItemSpec, inputs: Inputs, study: StudyFiles) -> StudyPage:
    settings, evolved = spec.settings, _curves(EVOLUTION, inputs)
    analysed = {name.chain: files for name, files in inputs.items() if name.role == ANALYSED}
    done = {part: files for part, files in analysed.items() if isinstance(part, OutputId)}
    return StudyPage(
        settings=settings,
        tables=read_tables(done, settings),
        curves=_by_arm(evolved),
        assessed={group: one for group in settings.ensembles if (one := study.assessed(group)) is not None},
        throws=_throws(inputs),
        rejected=_rejected(list(evolved.values())),
        created_with=spec.made_with,
        digests=spec.digests,
        failed=spec.failed,
        not_possible=spec.not_possible,
        diverged=_diverged(settings, inputs, evolved),
    )


def _proposed(page: StudyPage, study: StudyFiles) -> list[Champion]:
    """Return the champion of each arm that is proposed for building; none without a tank."""
    chosen = {(row.environment, row.depth, row.trial) for row in page.rows("tank") if row.proposed}
    return [one for one in study.champions if (one.environment, one.depth, one.trial) in chosen]


def read_page(settings: Settings, upstream: Upstream, store: Store) -> StudyPage:
    """Return what the page shows of a study, without its replays."""
    item = _item(settings, _plan(settings)[0], 0, None, upstream)
    assert isinstance(item.spec, PageItemSpec)
    inputs = {name: source.read(store) for name, source in item.inputs.items()}
    study = StudyFiles(data_spec(settings, trials_of(settings, "transfer")), item.execution, inputs)
    return _study_page(item.spec, inputs, study)


def _curves(role: str, inputs: Inputs) -> dict[ChainId, Columns]:
    """Join the curves of each trial's segments."""
    parts: dict[ChainId, dict[str, bytes]] = {}
    for name, files in inputs.items():
        if name.role == role and name.chain:
            parts.setdefault(name.chain, {})[name.label] = files[segments.CURVE]
    return {trial: segments.join_curves(curves) for trial, curves in parts.items()}


def _by_arm(evolved: Mapping[ChainId, Columns]) -> Curves:
    """Return the best fitness by generation of each trial, by arm."""
    curves: dict[tuple[str, float], list[Columns]] = {}
    for trial, curve in evolved.items():
        assert isinstance(trial, TrialId)
        curves.setdefault((trial.environment, trial.depth), []).append(curve)
    return {arm: [curve["best_fitness"] for curve in own] for arm, own in curves.items()}


def _throws(inputs: Inputs) -> ThrowPaths | None:
    """Arrange the transitions of the main throws as paths; steps that tracked throws lack are NaN.

    Throws with negative numbers were not filmed, but simulated in the medium that was fitted to the others.
    """
    chunks = throws_among(inputs)
    if not chunks:
        return None
    table = read_transitions(chunks)
    table = table[table.throw >= 0]
    throws, first, number = np.unique(table.throw, return_index=True, return_inverse=True)
    path = np.full((len(throws), int(table.step.max()) + 1, 3), np.nan)
    path[number, table.step] = table.state[:, :3]
    return ThrowPaths(table.length_scale[first].astype(np.float64), path)


def _rejected(curves: Sequence[Columns]) -> dict[str, float]:
    """Return the share of the designs of each operator that were rejected, for operators that rejected some."""
    return {name: rejected / drawn for name, (drawn, rejected) in segments.draws_of(curves).items() if rejected}


def _diverged(settings: Settings, inputs: Inputs, evolved: Mapping[ChainId, Columns]) -> list[str]:
    """List what diverged, by trial."""
    adapted, groups, found = _curves(ADAPTATION, inputs), tuple(settings.ensembles), []
    for trial in trials_of(settings, "transfer"):
        label = trial.label
        if (curve := evolved.get(trial.in_stage("evolve"))) is not None:
            found.append((f"evolve: {label}", divergence.in_trial(curve)))
        if (scored := inputs.get(InputName(SCORED, trial))) is not None:
            scores = decode_scores(scored[SCORE], label)
            found.append((f"transfer: {label}", divergence.in_transfer(scores, adapted.get(trial))))
        for group in groups:
            assessment = AssessmentId(trial.in_stage("assess"), DataSetId(group, trial.replicate))
            if (share := inputs.get(InputName(ASSESSED, assessment))) is not None:
                found.append((f"assess: {assessment.label}", divergence.in_assessment(read_predictions([share]))))
    return [f"{where}: {what}" for where, what in found if what is not None]


def _summarise(settings: Settings, results: Results, store: Store) -> Summary:
    """Export the page, the figures and the film to the folder of the study."""
    files = {name: store.read(done, name) for (done,) in results.done.values() for name in done.files}
    folder = store.export(settings.name, files)
    no_page = f"no page: {results.failed.get(_PAGE_ID, 'it has not been made yet')}"
    lines = [f"{folder / PAGE}" if PAGE in files else no_page]
    lines += [f"{folder / name}: a robot to build" for name in files if name.startswith(PROPOSED)]
    artifacts = {name: data for name, data in files.items() if not name.startswith("robot-")}  # with their trials
    replays = {
        trial: {"replay.html": files[page]}
        for trial in trials_of(settings, "evolve")
        if (page := f"{robot_address(trial.environment, trial.depth, trial.index)}.html") in files
    }
    return Summary(lines=lines, artifacts=artifacts, films=replays, of_study=True)


REPORT = Stage(
    name="report",
    version=21,
    unit="pictures",
    reads=_reads,
    plan=_plan,
    item=_item,
    compute=_compute,
    summarise=_summarise,
)
