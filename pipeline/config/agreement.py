"""What settings must agree on beyond their own bounds: each mistake that a user may make is one line."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import ValidationError

from tasks.design import CONTROLLERS, OPEN_LOOP
from tasks.evolution import OBJECTIVES, SEARCHES
from tasks.residual.forms import form_named
from tasks.residual.learner import stated
from tasks.simulation.engine import ENGINES
from tasks.world import ENVIRONMENTS

if TYPE_CHECKING:
    from pipeline.config.settings import Settings


def check(settings: Settings) -> None:
    """Refuse settings whose groups contradict one another, and names of what does not exist."""
    if settings.physics.passive_joints == "locked" and settings.evolution.morphology.n_actuated is None:
        raise ValueError(
            "physics.passive_joints is locked, so motors decide which links form one body: "
            "expected evolution.morphology.n_actuated, the number of motors"
        )
    if settings.physics.continuous_collision and settings.work.engine != "reference":
        raise ValueError(
            f"physics.continuous_collision is on and work.engine is {settings.work.engine}, which lacks it: "
            "expected work.engine=reference, which takes about fifty times as long"
        )
    if settings.replicates > settings.grid.n_trials:
        raise ValueError(
            f"replicates is {settings.replicates} and grid.n_trials is {settings.grid.n_trials}, so some data sets "
            f"would have no trial: expected at least as many trials as replicates"
        )
    target = ENVIRONMENTS.get(settings.target)
    if settings.transfer.other_engines and target and target.engine:
        raise ValueError(
            f"transfer.engines is {', '.join(settings.transfer.engines)}, but target {target.name} is a part of the "
            f"engine {target.engine}: expected batch, which makes way for it"
        )
    for name, kind in ENVIRONMENTS.items():
        group = kind.settings_group or ""
        is_given = kind.settings is not None and kind.has_one_medium and getattr(settings, group) != kind.settings()
        if is_given and name not in (settings.target, *settings.grid.environments):
            raise ValueError(
                f"{group} is given, but neither target nor grid.environments has {name}, whose medium it is: "
                f"expected one of them to have it, got target {settings.target}"
            )
    n_motors, limits = settings.evolution.morphology.n_actuated, settings.design.n_links
    if (n_motors or 0) >= limits.least:
        raise ValueError(
            f"evolution.morphology.n_actuated is {n_motors}, expected less than design.n_links.least, {limits.least}: "
            "a joint for each motor"
        )
    _check_objective(settings)
    _check_learners(settings)
    controller, morphology = CONTROLLERS[settings.evolution.controller], settings.evolution.morphology
    if morphology.constrains_gaits and not controller.is_blind:
        raise ValueError(
            f"evolution.morphology constrains gaits, but evolution.controller {controller.name} needs "
            f"{controller.needs}, which no check of a gait knows: expected unjoined_links apart or may_overlap and "
            f"max_joint_speed null, or controller {OPEN_LOOP}"
        )
    _check_tracks(settings)
    if settings.tank is not None and settings.rollout.n_settle < 1:
        raise ValueError(
            "rollout.n_settle is 0, but a robot in the tank is measured from where it settles: "
            "expected at least 1, or tank to be null"
        )


def _check_learners(settings: Settings) -> None:
    """Refuse learners that contradict the study's groups, and names of what does not exist."""
    ensembles = [name for name, one in settings.learners.items() if not (one.single or one.mean)]
    for name, given in settings.learners.items():
        if name in ENVIRONMENTS:
            raise ValueError(f"learners.{name}: the name is taken: expected one of its own, got {name!r}")
        others = [one for one, value in given if one not in ("single", "mean") and one in given.model_fields_set]
        for use, source in (("single", given.single), ("mean", given.mean)):
            if source is not None and (others or source not in ensembles):
                beside = f" beside {', '.join(others)}" if others else ""
                raise ValueError(
                    f"learners.{name}.{use} is {source!r}{beside}: expected a learner with an ensemble, one of "
                    f"{', '.join(ensembles)}, and nothing beside it"
                )
        try:
            settings.learner(name)
        except ValidationError as error:
            said = error.errors()[0]["msg"].removeprefix("Value error, ")
            raise ValueError(f"learners.{name}, with the study's groups: {said}") from None
    known = (*ENVIRONMENTS, *settings.learners)
    media = [name for name, kind in ENVIRONMENTS.items() if kind.has_one_medium]
    simulated = {name: one for name, one in settings.arm_learners.items() if one.throws.source != "tracks"}
    if not simulated:  # else links are thrown into the target, which is no network's
        media += [name for name, one in settings.learners.items() if one.mean]
    for place, names, allowed in (
        ("target", (settings.target,), media),
        ("grid.environments", settings.grid.environments, known),
        ("transfer.adapted_environments", settings.transfer.adapted_environments or (), known),
        ("transfer.engines", settings.transfer.engines, tuple(ENGINES)),
        ("evolution.objective", (settings.evolution.objective,), tuple(OBJECTIVES)),
        ("evolution.search", (settings.evolution.search,), tuple(SEARCHES)),
        ("evolution.controller", (settings.evolution.controller,), tuple(CONTROLLERS)),
    ):
        for name in names:
            if name not in allowed:
                one_medium = "an environment of one medium, " if allowed is media else ""
                raise ValueError(f"{place}: expected {one_medium}any of {', '.join(allowed)}, got {name!r}")
    forms = {f"learners.{name}.": given.network.form for name, given in settings.learners.items()}
    for place, form_name in {"": settings.network.form, **forms}.items():
        try:
            form_named(form_name)
        except ValueError as error:
            raise ValueError(f"{place}{error}") from None
    for name, learner in settings.arm_learners.items():
        form, n_throws = form_named(learner.network.form), learner.throws.n_throws
        medium = settings.target_medium if name in simulated else None
        if medium and (why := form.objection(medium, settings.physics)):
            raise ValueError(f"network.form is {form.name} for {name}, but {settings.target_label} {why}")
        if n_throws < len(form.constants):
            raise ValueError(
                f"throws.n_throws is {n_throws} for {name}, but {form.name} has the constants "
                f"{', '.join(form.constants)}: expected at least {len(form.constants)}"
            )


def _check_tracks(settings: Settings) -> None:
    """Refuse tracks without a file, a file that is not used, and more data sets than there are."""
    from_tracks = settings.throws.source == "tracks"
    if from_tracks != (settings.tracks is not None):
        raise ValueError(
            f"throws.source is {settings.throws.source} and tracks {'is null' if from_tracks else 'names a file'}: "
            f"expected both, `puddle collect --tracks FILE` sets them, or neither"
        )
    for name in settings.learners:
        if not (learner := settings.learner(name)) or learner.throws.source != "tracks":
            continue
        if not from_tracks:
            raise ValueError(f"learners.{name}.throws.source is tracks, but throws.source is not: expected both")
        if others := sorted(stated(settings.learners[name].throws).keys() - {"source"}):
            raise ValueError(
                f"learners.{name}.throws states {', '.join(others)}, but its throws are the tracked ones of the "
                f"file: expected source simulation beside it, or nothing"
            )
    if from_tracks and settings.throws.design == "struck":
        raise ValueError(
            "throws.design is struck and throws.source is tracks, but nobody knows what struck a tracked bar: expected "
            "another design"
        )
    if from_tracks and settings.replicates > 1:
        raise ValueError(
            f"replicates is {settings.replicates} and throws.source is tracks, but there is one set of tracked throws: "
            f"expected 1"
        )


def _check_objective(settings: Settings) -> None:
    """Refuse an objective without its data."""
    objective, n_motors = settings.evolution.objective, settings.evolution.morphology.n_actuated
    if settings.evolution.maximised.over_depths and len(settings.objective_depths) < 2:
        raise ValueError(
            f"evolution.objective is {objective}, but evolution.objective_depths, or grid.depths where they are "
            f"null, has {len(settings.objective_depths)} depth: expected at least 2"
        )
    if settings.evolution.maximised.motor_work and (settings.physics.max_motor_torque == 0 or n_motors == 0):
        which = "evolution.morphology.n_actuated" if n_motors == 0 else "physics.max_motor_torque"
        raise ValueError(f"evolution.objective is {objective}, but {which} is 0: expected motors that do work")
