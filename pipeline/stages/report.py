"""report: the page of a study, its figures and tables as files, and the film of its first screen."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from pipeline.config.settings import Settings, WorkSettings
from pipeline.report.page import draw_all, heroes, render_page, render_robot, robot_address
from pipeline.report.render import tables_of, typeset
from pipeline.report.replay import FILM_FPS
from pipeline.report.study_page import StudyPage, ThrowPaths
from pipeline.stages import divergence, segments
from pipeline.stages.analyse import tables_of_study
from pipeline.stages.reader import DataSpec, StudyReader, data_spec, inputs_of, read_inputs, read_study
from pipeline.stages.replays import best_replays, elite_replays, replays_of
from pipeline.store.design_file import design_json
from pipeline.store.encoding import encode_json
from pipeline.store.manifest import Manifest
from pipeline.store.provenance import environment as provenance
from pipeline.store.store import Store
from pipeline.workflow.identity import OutputId, TrialId, arms_of, trials_of
from pipeline.workflow.stage import (
    Chain,
    Execution,
    Files,
    Inputs,
    Item,
    MissingInputs,
    Sources,
    Stage,
    Summary,
    Upstream,
)
from tasks.analysis.scores import Champion
from tasks.analysis.tables import ANALYSES
from tasks.residual import Transitions

PAGE = "index.html"  # the page's file
FILM = "replay"  # name of the film of the first screen, without suffix
PROPOSED = "proposed-"  # prefix of the design files of champions that are proposed for building
_PAGE_ID, _FILM_ID = OutputId(PAGE), OutputId("film")
_PICTURES_OF_PAGE = 4000  # approximate cost of the page, as pictures of a film
_SECONDS_PER_PICTURE = 4.4e-3


@dataclass(frozen=True)
class PageItemSpec:
    """The page of what is done."""

    settings: Settings  # those of the study without how its work is divided
    failed: tuple[str, ...]
    not_possible: tuple[str, ...]
    digests: tuple[tuple[str, str, str], ...]  # stage, label and digest of every chain that is done
    made_with: Mapping[str, str]


def _reads(settings: Settings) -> tuple[str, ...]:
    rest = ("evolve", "adapt", "transfer", "assess", "analyse")
    return ("collect", "train", *rest) if settings.needs_ensemble else rest


def _plan(settings: Settings) -> Sequence[Chain[Settings | DataSpec]]:
    """Plan the page, and the film of its first screen."""
    deepest = [trial for trial in trials_of(settings, "transfer") if trial.depth == max(settings.grid.depths)]
    pictures = 2 * settings.rollout.n_measure * settings.physics.time_step * FILM_FPS
    whole = settings.model_copy(update={"work": WorkSettings()})
    return [
        Chain(_PAGE_ID, (_PICTURES_OF_PAGE,), whole, _SECONDS_PER_PICTURE),
        Chain(_FILM_ID, (pictures,), data_spec(settings, deepest), _SECONDS_PER_PICTURE),
    ]


def _item(
    settings: Settings, chain: Chain[Settings | DataSpec], index: int, previous: Manifest | None, upstream: Upstream
) -> Item[PageItemSpec | DataSpec]:
    """Specify the film by champions and environments; the page by the small files of all that is done, too."""
    execution = Execution(settings.work.engine)
    if isinstance(chain.spec, DataSpec):
        inputs = _inputs(settings, chain.spec.trials, ["champions"], upstream)
        return Item(REPORT.name, REPORT.version, chain.label, chain.spec, inputs, execution)
    reads = ["champions", "predictions", "curves", "adaptations", "tables"]
    reads += ["populations"] if settings.evolution.search == "map_elites" else []
    inputs = _inputs(settings, trials_of(settings, "transfer"), reads, upstream)
    with suppress(MissingInputs):
        inputs |= inputs_of(settings, (), ["throws"], upstream)
    spec = page_spec(chain.spec, upstream)
    return Item(REPORT.name, REPORT.version, chain.label, spec, inputs, execution)


def page_spec(settings: Settings, upstream: Upstream) -> PageItemSpec:
    """Describe what is done and what failed."""
    lost = [
        (why.tried, f"{name}: {identity.label} {why}")
        for name in upstream
        for identity, why in upstream[name].failed.items()
    ]
    return PageItemSpec(
        settings,
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


def _inputs(settings: Settings, trials: Sequence[TrialId], reads: Sequence[str], upstream: Upstream) -> Sources:
    """Return what is read, and the networks; where one is missing there are no residual environments."""
    inputs = inputs_of(settings, trials, reads, upstream)
    with suppress(MissingInputs):
        inputs |= inputs_of(settings, trials, ["networks"], upstream)
    return inputs


def _compute(item: Item[PageItemSpec | DataSpec], inputs: Inputs) -> Files:
    spec = item.spec
    if isinstance(spec, DataSpec):
        return _film(read_inputs(spec, item.execution, inputs))
    of_all = data_spec(spec.settings, trials_of(spec.settings, "transfer"))
    return _page(spec, read_inputs(of_all, item.execution, inputs))


def _film(study: StudyReader) -> Files:
    """Make a GIF and an MP4 of the two robots of the first screen."""
    from pipeline.report.films import render_gif, render_mp4  # takes seconds to import

    shown = [replay for _, replay in heroes(best_replays(study))]
    if not shown:
        return {f"{FILM}.json": encode_json({"shown": []})}
    listed = [f"{replay.title}, in {replay.seen_in}, {replay.depth:g} m" for replay in shown]
    return {
        f"{FILM}.gif": render_gif(shown),
        f"{FILM}.mp4": render_mp4(shown),
        f"{FILM}.json": encode_json({"shown": listed}),
    }


def _page(spec: PageItemSpec, study: StudyReader) -> Files:
    """Draw the page and its figures, and write its tables and the design files of champions."""
    settings, page, elites = spec.settings, _study_page(spec, study), elite_replays(study)
    overrated = {row.key for row in page.rows("exploiters") if ANALYSES["exploiters"].shown(row)}
    page = replace(page, replays=[*replays_of(study, overrated), *(replay for _, replay in elites)])
    drawings = draw_all(page)
    files = {PAGE: render_page(page, drawings).encode(), **tables_of(page.tables, settings.evolution.maximised)}
    for champion in study.champions:
        files[f"{robot_address(*champion.key)}.json"] = design_json(champion.design)
    files |= {f"{replay.robot}.json": design_json(design) for design, replay in elites}
    for champion in _proposed(page, study):
        name = f"{PROPOSED}{champion.environment}-{champion.depth:g}m".replace(".", "_")  # one dot in a file name
        files[f"{name}.json"] = design_json(champion.design)
    for replay in page.replays:
        if replay.in_target and replay.robot:
            moved = f"{replay.displacement:z.1f} m in {replay.duration:.0f} s"
            words = f"{replay.seen_in}, {replay.depth:g} m deep: {moved}"
            files[f"{replay.robot}.html"] = render_robot(replay, [typeset(words)]).encode()
    for drawing in drawings.values():
        files |= {f"{drawing.name}.svg": drawing.svg, f"{drawing.name}.png": drawing.png}
    return files


def _study_page(spec: PageItemSpec, study: StudyReader) -> StudyPage:
    settings, curves = spec.settings, study.curves()
    assessed = {name: study.assessed(name) for name in settings.ensembles}
    draws = segments.draws_of(list(curves.values())).items()
    return StudyPage(
        settings=settings,
        tables=tables_of_study(study, settings),
        curves={
            (arm.environment, arm.depth): [curves[trial]["best_fitness"] for trial in trials]
            for arm, trials in arms_of(list(curves)).items()
        },
        assessed={name: designs for name, designs in assessed.items() if designs is not None},
        throws=None if study.throws is None else _paths(study.throws),
        rejected={operator: rejected / drawn for operator, (drawn, rejected) in draws if rejected},
        created_with=spec.made_with,
        digests=spec.digests,
        failed=spec.failed,
        not_possible=spec.not_possible,
        diverged=[
            f"{stage}: {chain.label}: {what}"
            for stage in divergence.STAGES
            for chain, what in divergence.found(study, stage).items()
        ],
    )


def read_page(settings: Settings, upstream: Upstream, store: Store) -> StudyPage:
    """Return what the page shows of a study, without its replays."""
    return _study_page(page_spec(settings, upstream), read_study(settings, upstream, store))


def _proposed(page: StudyPage, study: StudyReader) -> list[Champion]:
    """Return the champion of each arm that is proposed for building; none without a tank."""
    chosen = {row.key for row in page.rows("tank") if row.proposed}
    return [champion for champion in study.champions if champion.key in chosen]


def _paths(throws: Transitions) -> ThrowPaths:
    """Arrange the transitions of throws as paths; steps that tracked throws lack are NaN.

    Throws with negative numbers were not filmed, but simulated in the medium that was fitted to the others.
    """
    table = throws[throws.throw >= 0]
    numbers, first, number = np.unique(table.throw, return_index=True, return_inverse=True)
    path = np.full((len(numbers), int(table.step.max()) + 1, 3), np.nan)
    path[number, table.step] = table.state[:, :3]
    return ThrowPaths(table.length_scale[first].astype(np.float64), path)


def _summarise(settings: Settings, upstream: Upstream, store: Store) -> Summary:
    """Export the page, the figures and the film to the folder of the study."""
    results = upstream["report"]
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
    version=24,
    unit="pictures",
    reads=_reads,
    plan=_plan,
    item=_item,
    compute=_compute,
    summarise=_summarise,
)
