"""report: the page that a person looks at, with the curves, the table of transfer and moving robots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from pipeline.artifacts import decode_json, decode_table
from pipeline.design_file import design_from
from pipeline.manifest import Manifest
from pipeline.provenance import environment as provenance
from pipeline.report import Drawing, Replay, draw_all, render_gif, render_page, replay_of
from pipeline.report.data import ENVIRONMENTS, Digest, Draws, ResidualError, StudyReport, TrialResult
from pipeline.report.replay import Overlay, at_frames
from pipeline.settings import EnvironmentName, Settings
from pipeline.stage import Chain, Files, Input, Item, Job, MissingInputs, Results, Stage, Summary, Upstream
from pipeline.stages import segments
from pipeline.stages.analyse import arm_label, read_table, tank_label
from pipeline.stages.collect import data_set
from pipeline.stages.findings import HISTORIES, findings
from pipeline.stages.train import ERRORS, UNIT_OF, read_errors
from pipeline.stages.transfer import CHAMPION, SCORE
from pipeline.store import Store
from tasks.analysis import acceleration, link_states
from tasks.design import Designs
from tasks.evolution import OPERATORS
from tasks.simulation import OK, simulate
from tasks.world import DryLand, TrueSlush

NAME, VERSION = "report", 3

PAGE, REPLAY = "index.html", "replay.gif"

MOST_STEPS_IN_TANK = 60 * 60
"""Of the films of the tank; a minute of a robot that goes nowhere is enough."""

N_REPLAYS_IN_GIF = 2
"""Robots in the moving picture: the best with residuals above the best without."""


def reads(settings: Settings) -> tuple[str, ...]:
    """Everything."""
    rest = ("evolve", "transfer", "assess", "analyse")
    return ("collect", "train", *rest) if settings.needs_ensemble else rest


def plan(settings: Settings) -> Sequence[Chain]:
    """One page."""
    spec = {"settings": settings.model_dump(mode="json", exclude={"work"})}
    return [Chain(label=PAGE, units=(1,), spec=spec)]


def item(settings: Settings, chain: Chain, index: int, previous: Manifest | None, upstream: Upstream) -> Item:
    """Specify the page: the small files of all that is done, and the names of what was set aside."""
    inputs: dict[str, Input] = {}
    for label, (member,) in upstream["train"].done.items():
        inputs[f"train/{label}"] = Input(member, (ERRORS,))
    for label, trial in upstream["evolve"].done.items():
        for number, segment in enumerate(trial):
            inputs[f"evolve/{label}/{number:04d}"] = Input(segment, (segments.CURVE,))
    for label, trial in upstream["transfer"].done.items():
        inputs[f"transfer/{label}"] = Input(trial[-1], tuple(n for n in (SCORE, CHAMPION) if n in trial[-1].files))
    for label, (analysis,) in upstream["analyse"].done.items():
        inputs[f"analyse/{label}"] = Input(analysis, tuple(analysis.files))
    if settings.needs_ensemble:
        with suppress(MissingInputs):  # the figure of the data set says that there is none
            inputs |= data_set(upstream["collect"])
    inputs |= _family_inputs(settings, upstream)
    set_aside = [f"{name}: {label} {why}" for name in upstream for label, why in upstream[name].set_aside.items()]
    digests = [
        [name, label, manifests[-1].digest]
        for name in upstream
        for label, manifests in upstream[name].done.items()
        if name in reads(settings)
    ]
    spec = {**chain.spec, "set_aside": set_aside, "digests": digests, "made_with": dict(provenance())}
    return Item(NAME, VERSION, chain.label, spec, inputs, how={"engine": settings.work.engine})


def replay_name(replay: Replay) -> str:
    """Name the moving picture of one robot; the store wants no second dot in a name."""
    return f"replay-{replay.environment}-{replay.depth:g}m".replace(".", "_") + ".gif"


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
    """Draw the page, and one moving picture."""
    settings = Settings.model_validate(job.spec["settings"])
    trials = [result for row in settings.grid.trials() if (result := _trial_result(row, inputs)) is not None]
    replays = _replays(settings, trials, inputs, job.how["engine"])
    proposed = _proposed(settings, inputs)
    in_tank = [film for row in proposed for film in _tank_replays(settings, row, inputs, job.how["engine"])]
    found = findings(inputs, assessed_depth=settings.assessed_depth, tank=settings.tank)
    report = StudyReport(
        name=settings.name,
        title=f"Robots evolved for slush: {settings.name}",
        created_with=job.spec["made_with"],
        settings_yaml=yaml.safe_dump(job.spec["settings"], sort_keys=False),
        trials=trials,
        residual_errors=_residual_errors(inputs),
        replays=[*replays, *in_tank],
        findings=found,
        draws=_draws(inputs),
        measured_seconds=settings.rollout.n_measure * settings.physics.time_step,
        digests=[Digest(*row) for row in job.spec["digests"]],
        set_aside=[*job.spec["set_aside"], *_without_champion(settings, inputs)],
    )
    drawings = draw_all(report)
    files = {PAGE: render_page(report, drawings).encode()}
    for drawing in drawings.values():
        if isinstance(drawing, Drawing):
            files |= {f"{drawing.name}.svg": drawing.svg, f"{drawing.name}.png": drawing.png}
    for replay in replays:
        files[replay_name(replay)] = render_gif([replay])
    for environment, depth, trial in proposed:
        files[proposal_name(environment, depth)] = _champion_file(inputs, environment, depth, trial)
    if replays:
        files[REPLAY] = render_gif(_for_the_gif(replays))
    return files


def _trial_result(row: tuple[Any, float, int], inputs: Mapping[str, Files]) -> TrialResult | None:
    """Gather one trial's curve and scores; None where it was set aside. A champion that diverged has NaN for scores."""
    environment, depth, trial = row
    label = segments.trial_label(environment, depth, trial)
    scored = inputs.get(f"transfer/{label}")
    if scored is None:
        return None
    scores = decode_json(scored[SCORE], label)
    prefix = f"evolve/{label}/"
    curves = [
        decode_table(inputs[name][segments.CURVE], schema="curve", version=1, source=name)["best_fitness"]
        for name in sorted(inputs)
        if name.startswith(prefix)
    ]
    measured = {
        name: np.nan if scores[name] is None else scores[name]
        for name in ("zero_shot", "zero_shot_com", "adapted", "adapted_com")
        if name in scores
    }
    predicted = scores.get("predicted", np.nan)
    return TrialResult(environment, depth, trial, predicted, **measured, curve=np.concatenate(curves))


def _draws(inputs: Mapping[str, Files]) -> list[Draws]:
    """Add up the draws of all trials by operator, where some were rejected."""
    curves = [
        decode_table(files[segments.CURVE], schema="curve", version=1, source=name)
        for name, files in inputs.items()
        if name.startswith("evolve/")
    ]
    totals = [
        Draws(
            operator,
            n_drawn=sum(int(curve[segments.drawn_column(operator)].sum()) for curve in curves),
            n_rejected=sum(int(curve[segments.rejected_column(operator)].sum()) for curve in curves),
        )
        for operator in OPERATORS
    ]
    return [of for of in totals if of.n_rejected]


def _without_champion(settings: Settings, inputs: Mapping[str, Files]) -> list[str]:
    """Name the trials that came to nothing."""
    lines = []
    for row in settings.grid.trials():
        label = segments.trial_label(*row)
        if f"transfer/{label}" in inputs:
            status = decode_json(inputs[f"transfer/{label}"][SCORE], label)["status"]
            lines += [f"evolve: {label} {status}"] if status != "ok" else []
    return lines


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


def _zero_shot(trial: TrialResult) -> float:
    """How far a champion got in True Slush; -inf if it diverged."""
    return trial.zero_shot if trial.zero_shot is not None and np.isfinite(trial.zero_shot) else -np.inf


def _replays(
    settings: Settings, trials: Sequence[TrialResult], inputs: Mapping[str, Files], engine: Any
) -> list[Replay]:
    """Film the best zero-shot champion of every arm in True Slush, deepest first."""
    best: dict[tuple[float, str], TrialResult] = {}
    for trial in trials:
        arm = (trial.depth, trial.environment)
        if _zero_shot(trial) > (_zero_shot(best[arm]) if arm in best else -np.inf):
            best[arm] = trial
    replays = []
    for (depth, environment), trial in sorted(best.items(), key=lambda entry: -entry[0][0]):
        label = segments.trial_label(environment, depth, trial.trial)
        design = design_from(decode_json(inputs[f"transfer/{label}"][CHAMPION], label), label)
        rollouts = simulate(
            design,
            TrueSlush(depth=depth, slush=settings.slush),
            n_settle=settings.rollout.n_settle,
            n_measure=settings.rollout.n_measure,
            engine=engine,
            trace=True,
            physics=settings.physics,
        )
        assert rollouts.trace is not None and rollouts.status[0] == OK
        replays.append(
            replay_of(
                design,
                rollouts.trace[0],
                title=f"Evolved {ENVIRONMENTS[trial.environment].evolved}, trial {trial.trial}",
                environment=environment,
                world="True Slush",
                depth=depth,
                has_medium=True,
                n_settle=settings.rollout.n_settle,
                overlays=_overlays(settings, inputs.get(f"analyse/{arm_label(environment, depth)}", {}), trial.trial),
                push=_push(settings, design, rollouts.trace),
            )
        )
    return replays


LAID_OVER = (
    ("disagreement", "what the members disagree about", "m/s²", 0.0),
    ("novelty", "distance from the throws", "× usual", 1.0),
)
"""Column of the instruments' links, what the page calls it, its unit, and what the darkest colour is at least: within
the usual distance a state is not new."""


def _overlays(settings: Settings, instruments: Files, trial: int) -> tuple[Overlay, ...]:
    """Read what the instruments say of the champion's links in True Slush; nothing where they filmed no one."""
    if not instruments:
        return ()
    worlds, links = read_table(instruments, "worlds"), read_table(instruments, "links")
    if not ((worlds["world"] == "true_slush") & (worlds["trial"] == trial)).any():
        return ()
    here = links["world"] == "true_slush"
    n_links = int(links["link"].max()) + 1
    return tuple(
        Overlay(label, unit, at_frames(links[column][here].reshape(-1, n_links), settings.rollout.n_settle), least)
        for column, label, unit, least in LAID_OVER
        if np.isfinite(links[column][here]).any()
    )


def _push(settings: Settings, design: Designs, trace: npt.NDArray[np.float32]) -> npt.NDArray[np.float64]:
    """Compute how the slush speeds up each link at each frame: (n_frames, n_links, 2) [m/s²]."""
    links = link_states(design, trace, settings.physics)
    return at_frames(acceleration(settings.slush, links, settings.physics)[0, ..., :2], settings.rollout.n_settle)


def proposal_name(environment: str, depth: float) -> str:
    """Name the design file of the champion of an arm that is proposed for building."""
    return f"proposed-{environment}-{depth:g}m".replace(".", "_") + ".json"


def _proposed(settings: Settings, inputs: Mapping[str, Files]) -> list[tuple[EnvironmentName, float, int]]:
    """Find each arm's champion that is proposed for building: environment, depth and trial; none without a tank."""
    found = []
    for environment, depth in dict.fromkeys(trial[:2] for trial in settings.grid.trials()):
        files = inputs.get(f"analyse/{tank_label(environment, depth)}", {})
        table = read_table(files, "tank") if files else {"trial": np.array([]), "proposed": np.array([], dtype=bool)}
        found += [(environment, depth, int(trial)) for trial in table["trial"][table["proposed"]]]
    return found


def _champion_file(inputs: Mapping[str, Files], environment: str, depth: float, trial: int) -> bytes:
    return inputs[f"transfer/{segments.trial_label(environment, depth, trial)}"][CHAMPION]


def _tank_replays(
    settings: Settings, proposed: tuple[EnvironmentName, float, int], inputs: Mapping[str, Files], engine: Any
) -> list[Replay]:
    """Film a proposed champion in the tank and on its dry floor. They show a tank, so they are of no environment."""
    assert settings.tank is not None
    environment, depth, trial = proposed
    label = segments.trial_label(environment, depth, trial)
    design = design_from(decode_json(_champion_file(inputs, environment, depth, trial), label), label)
    tank, n_settle = settings.tank, settings.rollout.n_settle
    replays = []
    for world, words in (
        (TrueSlush(depth=tank.simulated_depth, slush=settings.slush), "the tank"),
        (DryLand(depth=0.0), "the drained tank"),
    ):
        rollouts = simulate(
            design,
            world,
            n_settle=n_settle,
            n_measure=min(tank.n_steps(settings.physics.time_step), MOST_STEPS_IN_TANK),
            engine=engine,
            trace=True,
            physics=settings.physics,
        )
        if rollouts.status[0] == OK:
            assert rollouts.trace is not None
            replays.append(
                replay_of(
                    design,
                    rollouts.trace[0],
                    title=f"To build: evolved {ENVIRONMENTS[environment].evolved}, trial {trial}, in {words}",
                    environment="",
                    world=words,
                    depth=round(world.depth, 2),
                    has_medium=isinstance(world, TrueSlush),
                    n_settle=n_settle,
                )
            )
    return replays


def _for_the_gif(replays: Sequence[Replay]) -> list[Replay]:
    """Choose the robots at the greatest depth evolved with residuals and without, where both are there."""
    deepest = [replay for replay in replays if replay.depth == replays[0].depth]
    wanted = [r for name in ("residual_slush", "dry_land") for r in deepest if r.environment == name]
    return wanted[:N_REPLAYS_IN_GIF] or deepest[:1]


def summarise(settings: Settings, results: Results, store: Store) -> Summary:
    """Put the page where a person finds it."""
    if PAGE not in results.done:
        return Summary(lines=[f"no page: {results.set_aside.get(PAGE, 'it is not made yet')}"])
    (page,) = results.done[PAGE]
    files = {name: store.read(page, name) for name in page.files}
    folder = store.export(settings.name, files)
    lines = [str(folder / PAGE), *(f"{folder / name}: a robot to build" for name in files if name.endswith(".json"))]
    return Summary(lines=lines, artifacts=files, of_study=True)


STAGE = Stage(
    name=NAME,
    version=VERSION,
    unit="pages",
    reads=reads,
    plan=plan,
    item=item,
    compute=compute,
    summarise=summarise,
)
