"""report: the page that a person looks at, its figures as SVG and PNG, and its moving robots as GIF and MP4."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import yaml

from pipeline.config.settings import RESIDUAL_ENVIRONMENTS, Settings
from pipeline.report import Drawing, Replay, draw_all, render_films, render_page
from pipeline.report.camera import FILM_FPS
from pipeline.report.data import ArtifactDigest, Draws, ResidualError, StudyReport, TrialResult
from pipeline.stages import divergence, segments
from pipeline.stages.analyse import arms_of
from pipeline.stages.assess import PREDICTIONS, read_predictions
from pipeline.stages.collect import data_set
from pipeline.stages.proposed_design import PROPOSED, proposal_files, proposed, tank_replays
from pipeline.stages.report_findings import HISTORIES, findings
from pipeline.stages.report_replays import replays_of
from pipeline.stages.train import ERRORS, UNIT_OF, read_errors
from pipeline.stages.transfer import CHAMPION, SCORE
from pipeline.store.encoding import decode_json, encode_json
from pipeline.store.manifest import Manifest
from pipeline.store.provenance import environment as provenance
from pipeline.store.store import Store
from pipeline.workflow.stage import (
    NOT_POSSIBLE,
    Chain,
    Files,
    Input,
    Item,
    Job,
    MissingInputs,
    Results,
    Stage,
    Summary,
    Upstream,
)
from tasks.evolution import OPERATORS

NAME, VERSION = "report", 7

PAGE, FILMS = "index.html", "films"
"""Label of the page's work, which is also its file; beginning of the labels of the films'."""

TOGETHER = "replay"
"""File name, without suffix, of the film that shows two robots: the best with residuals above the best without."""

EVOLUTION, ADAPTATION = "evolve/", "adaptation/"
"""How the names of inputs begin that are the curves of trials, and of their adaptations."""

PICTURES_OF_PAGE = 4000
"""About what the page costs, as pictures of a film."""


def reads(settings: Settings) -> tuple[str, ...]:
    """Everything."""
    rest = ("evolve", "transfer", "assess", "analyse")
    return ("collect", "train", *rest) if settings.needs_ensemble else rest


def plan(settings: Settings) -> Sequence[Chain]:
    """One page, the films of every arm, and the film of two robots."""
    whole = settings.model_dump(mode="json", exclude={"work"})
    trials = settings.grid.trials()
    measured_seconds = settings.rollout.n_measure * settings.physics.time_step
    pictures = measured_seconds * FILM_FPS
    deepest = max(settings.grid.depths)

    def films(label: str, of: Sequence[tuple[Any, float, int]], n_films: int, *, together: bool) -> Chain:
        listing = f"{FILMS}-{label}".replace("/", "-").replace(".", "_") + ".json"
        worlds = segments.groups_of(settings, "true_slush", *(environment for environment, _, _ in of))
        spec = {"physics": whole["physics"], "rollout": whole["rollout"], **worlds}
        spec |= {"trials": [list(trial) for trial in of], "together": together, "listing": listing}
        return Chain(f"{FILMS}/{label}", (n_films * pictures,), spec)

    page = {"settings": whole, "trials": [list(trial) for trial in trials]}
    chains = [Chain(PAGE, (PICTURES_OF_PAGE,), page)]
    for environment, depth in arms_of(trials):
        arm = [trial for trial in trials if trial[:2] == (environment, depth)]
        n_films = 1 if environment == "true_slush" else 2
        chains.append(films(f"{environment}/{depth:g}m", arm, n_films, together=False))
    both = [trial for name in ("residual_slush", "dry_land") for trial in trials if trial[:2] == (name, deepest)]
    return [*chains, films("together", both or [t for t in trials if t[1] == deepest], 2, together=True)]


def item(settings: Settings, chain: Chain, index: int, previous: Manifest | None, upstream: Upstream) -> Item:
    """Specify films by their champions and worlds; the page by the small files of all that is done, too."""
    inputs: dict[str, Input] = {}
    for environment, depth, number in chain.spec["trials"]:
        label = segments.trial_label(environment, depth, number)
        if label in upstream["transfer"].done:
            scored = upstream["transfer"].done[label][-1]
            inputs[f"transfer/{label}"] = Input(scored, tuple(n for n in (SCORE, CHAMPION) if n in scored.files))
    if any(row[0] in RESIDUAL_ENVIRONMENTS for row in chain.spec["trials"]):
        with suppress(MissingInputs):  # where a member is missing there are no residual worlds to film
            inputs |= segments.world_inputs(settings, "residual_slush", 0, upstream)
    execution = {"engine": settings.work.engine, "designs_per_batch": None}
    if chain.label != PAGE:
        return Item(NAME, VERSION, chain.label, chain.spec, inputs, execution)
    for label, (member,) in upstream["train"].done.items():
        inputs[f"train/{label}"] = Input(member, (ERRORS,))
    for label, trial in upstream["evolve"].done.items():
        for number, segment in enumerate(trial):
            inputs[f"{EVOLUTION}{label}/{number:06d}"] = Input(segment, (segments.CURVE,))
    for label, (*adaptation, _) in upstream["transfer"].done.items():
        for number, segment in enumerate(adaptation):
            inputs[f"{ADAPTATION}{label}/{number:06d}"] = Input(segment, (segments.CURVE,))
    for label, (share,) in upstream["assess"].done.items():
        inputs[f"assess/{label}"] = Input(share, (PREDICTIONS,))
    for label, (analysis,) in upstream["analyse"].done.items():
        inputs[f"analyse/{label}"] = Input(analysis, tuple(analysis.files))
    if settings.needs_ensemble:
        with suppress(MissingInputs):  # the figure of the data set says that there is none
            inputs |= data_set(upstream["collect"])
    inputs |= _family_inputs(settings, upstream)
    lost = [(f"{name}: {label} ", why) for name in upstream for label, why in upstream[name].failed.items()]
    failed = [what + why for what, why in lost if not why.startswith(NOT_POSSIBLE)]
    not_possible = [what + why for what, why in lost if why.startswith(NOT_POSSIBLE)]
    digests = [
        [name, label, manifests[-1].digest]
        for name in upstream
        for label, manifests in upstream[name].done.items()
        if name in reads(settings)
    ]
    spec = {**chain.spec, "failed": failed, "not_possible": not_possible}
    spec |= {"digests": digests, "made_with": dict(provenance())}
    return Item(NAME, VERSION, chain.label, spec, inputs, execution)


def _family_inputs(settings: Settings, upstream: Upstream) -> dict[str, Input]:
    """Give the history of one trial: the first that is done where residuals matter most."""
    deepest = sorted(settings.grid.trials(), key=lambda row: (row[0] != "residual_slush", -row[1], row[2]))
    for row in deepest:
        label = segments.trial_label(*row)
        if label in upstream["evolve"].done:
            trial = upstream["evolve"].done[label]
            return {f"{HISTORIES}{label}/{n:06d}": Input(part, (segments.HISTORY,)) for n, part in enumerate(trial)}
    return {}


def compute(job: Job, inputs: Mapping[str, Files]) -> Files:
    """Draw the page, or make films."""
    return _page(job, inputs) if "settings" in job.spec else _films(job, inputs)


def _films(job: Job, inputs: Mapping[str, Files]) -> Files:
    """Make a GIF and an MP4 of each replay, or of those in True Slush above one another.

    A listing says what each film shows; it is empty where no champion of the arm could be filmed.
    """
    replays = replays_of(job.spec, job.execution, inputs)
    named = {film_name(replay): [replay] for replay in replays}
    if job.spec["together"]:
        above = sorted((r for r in replays if r.in_true_slush), key=lambda r: r.environment != "residual_slush")
        named = {TOGETHER: above[:2]} if above else {}
    files: dict[str, bytes] = {}
    for name, shown in named.items():
        files[f"{name}.gif"], files[f"{name}.mp4"] = render_films(shown)
    listed = {
        name: [f"{one.title}, in {one.seen_in}, {one.depth:g} m" for one in shown] for name, shown in named.items()
    }
    return {**files, job.spec["listing"]: encode_json(listed)}


def film_name(replay: Replay) -> str:
    """Name the film of one robot; the store wants no dot in a name."""
    world = "" if replay.in_true_slush else "-at-home"
    return f"{TOGETHER}-{replay.environment}-{replay.depth:g}m".replace(".", "_") + world


def _page(job: Job, inputs: Mapping[str, Files]) -> Files:
    """Draw the page and its figures."""
    settings = Settings.model_validate(job.spec["settings"])
    evolved = _curves(EVOLUTION, inputs)
    trials = [result for row in settings.grid.trials() if (result := _trial_result(row, inputs, evolved)) is not None]
    rows = proposed(settings, inputs)
    replays = replays_of({**job.spec["settings"], "trials": job.spec["trials"]}, job.execution, inputs)
    in_tank = [film for row in rows for film in tank_replays(settings, row, inputs, job.execution["engine"])]
    report = StudyReport(
        name=settings.name,
        title=f"Robots evolved for slush: {settings.name}",
        created_with=job.spec["made_with"],
        settings_yaml=yaml.safe_dump(job.spec["settings"], sort_keys=False),
        trials=trials,
        residual_errors=_residual_errors(inputs),
        replays=[*replays, *in_tank],
        findings=findings(inputs, settings),
        draws=_draws(evolved.values()),
        measured_seconds=settings.rollout.n_measure * settings.physics.time_step,
        digests=[ArtifactDigest(*row) for row in job.spec["digests"]],
        failed=job.spec["failed"],
        not_possible=job.spec["not_possible"],
        diverged=_diverged(settings, inputs, evolved),
    )
    drawings = draw_all(report)
    files = {PAGE: render_page(report, drawings).encode(), **proposal_files(rows, inputs)}
    for drawing in drawings.values():
        if isinstance(drawing, Drawing):
            files |= {f"{drawing.name}.svg": drawing.svg, f"{drawing.name}.png": drawing.png}
    return files


def _curves(kind: str, inputs: Mapping[str, Files]) -> dict[str, divergence.Table]:
    """Join the curves of each trial's segments, by label."""
    parts: dict[str, dict[str, bytes]] = {}
    for name in sorted(inputs):
        if name.startswith(kind):
            label, _, _ = name.removeprefix(kind).rpartition("/")
            parts.setdefault(label, {})[name] = inputs[name][segments.CURVE]
    return {label: segments.join_curves(of) for label, of in parts.items()}


def _trial_result(
    row: tuple[Any, float, int], inputs: Mapping[str, Files], evolved: Mapping[str, divergence.Table]
) -> TrialResult | None:
    """Gather one trial's curve and scores; None where it was set aside. A champion that diverged has NaN for scores."""
    environment, depth, trial = row
    label = segments.trial_label(environment, depth, trial)
    scored = inputs.get(f"transfer/{label}")
    if scored is None:
        return None
    scores = decode_json(scored[SCORE], label)
    measured = {
        name: np.nan if scores[name] is None else scores[name]
        for name in ("zero_shot", "zero_shot_com", "adapted", "adapted_com")
        if name in scores
    }
    predicted = scores.get("predicted", np.nan)
    return TrialResult(environment, depth, trial, predicted, **measured, curve=evolved[label]["best_fitness"])


def _draws(curves: Collection[divergence.Table]) -> list[Draws]:
    """Add up the draws of all trials by operator, where some were rejected."""
    totals = [
        Draws(
            operator,
            n_drawn=sum(int(curve[segments.drawn_column(operator)].sum()) for curve in curves),
            n_rejected=sum(int(curve[segments.rejected_column(operator)].sum()) for curve in curves),
        )
        for operator in OPERATORS
    ]
    return [of for of in totals if of.n_rejected]


def _diverged(settings: Settings, inputs: Mapping[str, Files], evolved: Mapping[str, divergence.Table]) -> list[str]:
    """Say what diverged, trial by trial."""
    adapted = _curves(ADAPTATION, inputs)
    said = []
    for label in (segments.trial_label(*row) for row in settings.grid.trials()):
        if label in evolved:
            said.append((f"evolve: {label}", divergence.in_trial(evolved[label])))
        if (scored := inputs.get(f"transfer/{label}")) is not None:
            scores = decode_json(scored[SCORE], label)
            said.append((f"transfer: {label}", divergence.in_transfer(scores, adapted.get(label))))
        if (share := inputs.get(f"assess/{label}")) is not None:
            said.append((f"assess: {label}", divergence.in_assessment(read_predictions([share]))))
    return [f"{where}: {what}" for where, what in said if what is not None]


def _residual_errors(inputs: Mapping[str, Files]) -> list[ResidualError]:
    """Gather every member's errors by component and band of speed."""
    rows = []
    members = sorted(name for name in inputs if name.startswith("train/"))
    for member, name in enumerate(members):
        errors = read_errors(inputs[name][ERRORS], name)
        for component, band, rmse, relative in zip(
            errors["component"], errors["band"], errors["rmse"], errors["relative_error"], strict=True
        ):
            if band != "all" and np.isfinite(rmse):
                known = np.isfinite(relative) and relative > 0
                rows.append(
                    ResidualError(
                        member=member,
                        component=str(component),
                        unit=UNIT_OF[str(component)],
                        speed_band=f"{band} m/s",
                        rmse=float(rmse),
                        rms_residual=float(rmse / relative) if known else 0.0,
                    )
                )
    return rows


def summarise(settings: Settings, results: Results, store: Store) -> Summary:
    """Put the page, the figures and the films where a person finds them."""
    files = {name: store.read(done, name) for (done,) in results.done.values() for name in done.files}
    folder = store.export(settings.name, files)
    no_page = f"no page: {results.failed.get(PAGE, 'it is not made yet')}"
    # MLflow shows both kinds of films, and a GIF is ten times an MP4: it gets the one GIF that tells the story.
    artifacts = {name: data for name, data in files.items() if not name.endswith(".gif") or name == f"{TOGETHER}.gif"}
    lines = [f"{folder / PAGE}" if PAGE in files else no_page]
    lines += [f"{folder / name}: a robot to build" for name in files if name.startswith(PROPOSED)]
    return Summary(lines=lines, artifacts=artifacts, of_study=True)


STAGE = Stage(
    name=NAME, version=VERSION, unit="pictures", reads=reads, plan=plan, item=item, compute=compute, summarise=summarise
)
