"""puddle sensitivity: how far robots travel if what the paper leaves open is decided differently."""

import contextlib
import functools
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.cluster import Cluster
from pipeline.commands.exit_codes import INCOMPLETE, interruptible
from pipeline.commands.options import ExecutionOptions, StudyOptions, with_options
from pipeline.commands.output import to_stderr, to_stdout
from pipeline.errors import PuddleError

if TYPE_CHECKING:
    from pipeline.config.open_choices import OpenChoice
    from pipeline.config.settings import Settings
    from pipeline.report.sensitivity_page import Sensitivity
    from pipeline.stages.trial_scores import TrialScores
    from pipeline.workflow.identity import TrialId
    from pipeline.workflow.stage import Upstream
    from tasks.analysis.scores import ScoredArm
    from tasks.arrays import Float64

_LAST_STAGE = "transfer"
_POWER, _MAX_TRIALS = 0.8, 40


def _names_of_variants(incomplete: str) -> list[str]:
    """Complete the name of a variant."""
    from pipeline.config.open_choices import OPEN_CHOICES

    return [choice.name for choice in OPEN_CHOICES if choice.name.startswith(incomplete)]


@with_options
def sensitivity(
    context: typer.Context,
    options: StudyOptions,
    execution: ExecutionOptions,
    variants: Annotated[
        list[str] | None,
        typer.Option("--variant", autocompletion=_names_of_variants, help="Only this one; default all that apply."),
    ] = None,
    power: Annotated[float, typer.Option("--power", help="Probability of showing a difference that matters.")] = _POWER,
    max_trials: Annotated[int, typer.Option("--max-trials", min=2, help="Most trials of a study.")] = _MAX_TRIALS,
    out: Annotated[Path, typer.Option("--out", help="The page to write, a file that ends in .md.")] = Path(
        "sensitivity.md"
    ),
) -> None:
    """Vary the choices that the paper leaves open, one at a time, and test whether robots travel as far.

    Each variant is a study of the store, at the greatest depth of the settings; a run that is stopped resumes. First
    a pilot runs with the settings' trials; from its deviation follows how many trials all studies get.
    """
    from pipeline.report.sensitivity_page import SENSITIVITY, sensitivity_lines, sensitivity_page

    execution.check(context)
    check_page_path(out)
    if not 0 < power < 1:
        raise PuddleError(f"--power: expected a probability between 0 and 1, got {power:g}")
    plan = plan_of(options.settings(), variants or ())
    with interruptible():
        found = _run(plan, options, execution, power=power, max_trials=max_trials)
    for line in sensitivity_lines(found):
        to_stdout(line)
    try:
        out.with_suffix(".json").write_bytes(SENSITIVITY.dump_json(found) + b"\n")
        out.write_text(sensitivity_page(found))
    except OSError as error:
        raise PuddleError(f"--out: can't write {out}: {error.strerror}. Choose another file.") from None
    to_stdout("")
    to_stdout(f"Written: {out} and {out.with_suffix('.json')}")


def check_page_path(out: Path) -> None:
    """Refuse a path where no page can be written, before anything is computed.

    Raises:
        PuddleError: it has another suffix, its folder does not exist, or what is there is no such page.
    """
    from pipeline.report.sensitivity_page import FIRST_LINE

    if out.suffix != ".md" or not out.parent.is_dir():
        raise PuddleError(f"--out: expected a file name that ends in .md, in an existing folder, got {out}")
    try:
        if out.exists() and not (out.is_file() and out.read_bytes().startswith(FIRST_LINE.encode())):
            raise PuddleError(f"--out: expected a new file or such a page to replace, got {out}, which is neither")
    except OSError as error:
        raise PuddleError(f"--out: can't write {out}: {error.strerror}. Choose another file.") from None


@dataclass(frozen=True)
class SensitivityPlan:
    """The studies to run."""

    name: str  # of the study that variants depart from, which begins the names of theirs
    base: "Settings"
    choices: Sequence["OpenChoice"]
    names: Sequence[str]  # of the choices, if the user has named them
    left_out: Sequence[str]

    def study(self, choice: "OpenChoice", n_trials: int) -> "Settings":
        """Return the settings of a variant's study; controllers adapt only where that is what the choice concerns."""
        environment, quantity = choice.concerns
        adapted = environment if quantity == "adapted" else ""
        return choice.applied(
            self.base,
            f"name={self.name}-{choice.name}",
            f"grid.environments=[{environment}]",
            f"grid.n_trials={n_trials}",
            f"transfer.adapted_environments=[{adapted}]",
        )


def plan_of(settings: "Settings", names: Sequence[str]) -> SensitivityPlan:
    """Choose the variants and the arms that they concern.

    Args:
        settings: the study that variants depart from.
        names: names of the variants; all that apply if empty.

    Raises:
        PuddleError: there is no arm in True Slush, no such variant, or one that does not apply to the settings.
    """
    from pipeline.config.open_choices import OPEN_CHOICES, changed

    if "true_slush" not in settings.grid.environments:
        got = ", ".join(settings.grid.environments)
        raise PuddleError(f"grid.environments: expected true_slush, whose champions are compared, got {got}")
    if settings.grid.n_trials < 2:
        raise PuddleError("grid.n_trials is 1: expected at least 2, to estimate the deviation over trials")
    known = {choice.name: choice for choice in OPEN_CHOICES}
    for name in names:
        if name not in known:
            raise PuddleError(f"--variant {name}: expected one of {', '.join(known)}")
    chosen, left_out = [], []
    for choice in [known[name] for name in dict.fromkeys(names)] or OPEN_CHOICES:
        try:
            why = _why_not(settings, choice)
        except PuddleError as error:
            if names:
                raise
            why = f"{error}"
        if why and names:
            raise PuddleError(f"--variant {choice.name}: {why}")
        if why:
            left_out.append(f"{choice.name}: {why}")
        else:
            chosen.append(choice)
    arms = {choice.concerns for choice in chosen}
    base = changed(
        settings,
        f"name={settings.name}-base",
        f"grid.depths=[{max(settings.grid.depths)}]",
        f"grid.environments=[{', '.join(dict.fromkeys(('true_slush', *(arm for arm, _ in sorted(arms)))))}]",
        "grid.single_member_depths=[]",
        f"transfer.adapted_environments=[{', '.join(sorted(arm for arm, score in arms if score == 'adapted'))}]",
    )
    plan = SensitivityPlan(settings.name, base, chosen, names, left_out)
    for choice in chosen:
        plan.study(choice, settings.grid.n_trials)  # names that are too long are refused now
    return plan


def _why_not(settings: "Settings", choice: "OpenChoice") -> str:
    """Return why a choice can't be made differently in a study, or ""; raise PuddleError if settings contradict it."""
    environment, _ = choice.concerns
    if environment not in settings.grid.environments:
        return f"it concerns {environment}, which grid.environments lacks"
    if choice.applied(settings) == settings:
        return f"the settings have {choice.setting} already"
    return ""


def _run(
    plan: SensitivityPlan, options: StudyOptions, execution: ExecutionOptions, *, power: float, max_trials: int
) -> "Sensitivity":
    """Run the base, find the number of trials, and run every study with that many."""
    from pipeline.config.open_choices import changed
    from pipeline.report.sensitivity_page import Sensitivity, SensitivityRow
    from pipeline.store.provenance import environment
    from tasks.analysis.variant_effects import trials_to_show

    n_pilot = plan.base.grid.n_trials
    with _studies(options, execution) as (run, say):
        pilot = run(changed(plan.base, f"name={plan.name}-pilot"))
        arms = dict.fromkeys(choice.concerns for choice in plan.choices)
        needed = [trials_to_show(_known(pilot, arm), n_variants=len(plan.choices), power=power) for arm in arms]
        n_to_show = None if None in needed else max(n for n in needed if n is not None)
        n_trials = max(n_pilot, min(n_to_show or max_trials, max_trials))
        say(f"{n_trials} trials of each study; {n_to_show or 'more than 100,000'} show what is just not negligible")
        base = run(changed(plan.base, f"grid.n_trials={n_trials}"))
        of_variants = [run(plan.study(choice, n_trials)) for choice in plan.choices]
    afpo, settings = plan.base.evolution.afpo, plan.base
    return Sensitivity(
        command=shlex.join(
            [
                *shlex.split(options.command("sensitivity")),
                *(word for name in plan.names for word in ("--variant", name)),
                *(["--power", f"{power:g}"] if power != _POWER else []),
                *(["--max-trials", f"{max_trials}"] if max_trials != _MAX_TRIALS else []),
            ]
        ),
        source=options.source,
        scale=f"{settings.evolution.n_generations:,} generations of {afpo.population_size} designs",
        depth=max(settings.grid.depths),
        n_pilot=n_pilot,
        n_trials=n_trials,
        n_to_show=n_to_show,
        power=power,
        base_study=settings.name,
        base_digest=base.digest(),
        provenance=dict(environment()),
        left_out=tuple(plan.left_out),
        rows=tuple(
            SensitivityRow(
                choice.name,
                choice.decided,
                choice.instead,
                choice.setting,
                *choice.concerns,
                variant.settings.name,
                variant.digest(),
                variant.displacement(choice.concerns),
                base.displacement(choice.concerns),
            )
            for choice, variant in zip(plan.choices, of_variants, strict=True)
        ),
    )


def _known(base: "_FinishedStudy", arm: "ScoredArm") -> "Float64":
    """Return the displacements of the base's champions that have one; refuse too few, or champions that do not move."""
    import numpy as np

    from tasks.analysis.uncertainty import RESOLUTION, finite
    from tasks.analysis.variant_effects import negligible

    known = finite(np.array(base.displacement(arm), dtype=np.float64))  # None becomes NaN
    if len(known) < 2 or negligible(known) < RESOLUTION:
        environment, quantity = arm
        raise PuddleError(
            f"study {base.settings.name}: expected champions of {environment} that travel, {quantity}, in 2 trials or "
            f"more, got {', '.join(f'{value:.3g} m' for value in known) or 'none'}"
        )
    return known


@contextlib.contextmanager
def _studies(
    options: StudyOptions, execution: ExecutionOptions
) -> Iterator[tuple[Callable[["Settings"], "_FinishedStudy"], Callable[[str], None]]]:
    """Yield a function that runs a study up to the scores of its champions, all on one cluster, and one that tells."""
    from pipeline.commands.expected_time import expected_seconds
    from pipeline.stages import STAGES
    from pipeline.stages.transfer import read_scores
    from pipeline.tracking.mirror import Tracker
    from pipeline.workflow.driver import drive
    from pipeline.workflow.progress import progress

    store = options.open_store(create=True)
    wanted = STAGES[: [stage.name for stage in STAGES].index(_LAST_STAGE) + 1]
    with progress() as show, contextlib.ExitStack() as stack:

        @functools.cache
        def cluster() -> Cluster:
            return stack.enter_context(execution.cluster()())

        def shared() -> AbstractContextManager[Cluster]:
            return contextlib.nullcontext(cluster())

        def run(settings: "Settings") -> _FinishedStudy:
            show.say(f"study {settings.name}, {settings.grid.n_trials} trials")
            upstream = drive(
                settings,
                wanted,
                stages=STAGES,
                store=store,
                open_cluster=shared,
                tracker=Tracker(store.root, execution.tracking_uri, say=show.say),
                progress=show,
                how_to_run=lambda name: options.command("sensitivity"),
                source=options.source,
                expected_seconds=functools.partial(expected_seconds, settings),
            )
            found = upstream.items()
            failed = [
                f"{name}: {identity.label}: {why}"
                for name, results in found
                for identity, why in results.failed.items()
            ]
            if failed:
                to_stderr("\n".join([f"{len(failed)} chains of {settings.name} failed; the rest is done:", *failed]))
                raise typer.Exit(INCOMPLETE)
            return _FinishedStudy(settings, upstream, read_scores(settings, upstream[_LAST_STAGE], store))

        yield run, show.say


@dataclass(frozen=True)
class _FinishedStudy:
    settings: "Settings"
    upstream: "Upstream"
    scores: "Mapping[TrialId, TrialScores | None]"

    def displacement(self, arm: "ScoredArm") -> tuple[float | None, ...]:
        """Displacement of each trial's champion of an arm [m], None where there is none."""
        environment, quantity = arm
        of_arm = [scores for trial, scores in self.scores.items() if trial.environment == environment]
        return tuple(None if scores is None else scores.finite(quantity) for scores in of_arm)

    def digest(self) -> str:
        """SHA-256 of the digests of the study's items, of evolution and transfer."""
        from pipeline.store.encoding import canonical_json, digest

        stages = [self.upstream[name] for name in ("evolve", _LAST_STAGE)]
        items = sorted(one.digest for results in stages for chain in results.done.values() for one in chain)
        return digest(canonical_json(items))
