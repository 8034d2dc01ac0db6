"""puddle power: how many trials a difference needs."""

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.commands.options import DEFAULT_STORE, StorePath, StudyArgument, with_options
from pipeline.commands.output import to_stdout
from pipeline.errors import PuddleError

if TYPE_CHECKING:
    from pipeline.results.recorded_study import Study
    from tasks.analysis.scores import Quantity

_DIFFERENCES = (1.0, 2.0, 5.0)  # [m]
_QUANTITIES: "tuple[Quantity, ...]" = ("zero_shot", "adapted")


@with_options
def power(
    study: StudyArgument,
    differences: Annotated[
        list[float] | None, typer.Option("--difference", help="A difference of means [m]; default 1, 2 and 5.")
    ] = None,
    probability: Annotated[float, typer.Option("--power", help="Probability of showing the difference.")] = 0.8,
    store: StorePath = DEFAULT_STORE,
) -> None:
    """Tell how many trials a difference between two arms needs, from a study's own deviations.

    The test is the paper's: Student's t, two-sided, p < 0.05. Both arms have the deviation of the arm that is listed.
    Where an arm has several replicates, it includes the variance between them, and more trials are of more replicates.
    """
    from pipeline.results.recorded_study import open_study

    for line in power_lines(open_study(study, store), differences or _DIFFERENCES, probability):
        to_stdout(line)


def power_lines(study: "Study", differences: Sequence[float], power: float) -> Iterator[str]:
    """Yield a row for each arm: its deviation, and the trials per arm that each difference needs.

    Where an arm has several replicates, its deviation is the effective one, which includes the variance between them.

    Args:
        study: a recorded study.
        differences: differences of means [m].
        power: probability of showing them.

    Raises:
        PuddleError: a difference or the power is out of range, or no arm has two champions.
    """
    from tasks.analysis.replicates import nested
    from tasks.analysis.scores import QUANTITY_WORDS
    from tasks.analysis.statistical_power import effective_deviation, n_nested_trials_for

    if not 0 < power < 1:
        raise PuddleError(f"--power: expected a probability between 0 and 1, got {power:g}")
    for difference in differences:
        if not (math.isfinite(difference) and difference > 0):
            raise PuddleError(f"--difference: expected a difference above 0 m, got {difference:g}")
    scores = study.scores()
    arms = dict.fromkeys(zip(scores.depth, scores.evolved_in, strict=True))
    rows, any_nested = [], False
    for depth, environment in sorted(arms, key=lambda arm: -arm[0]):
        for quantity in _QUANTITIES:
            sample = scores.sample(environment, quantity, depth)
            n = len(sample.values)
            if n > 1:
                needed = (n_nested_trials_for(difference, sample, power=power) for difference in differences)
                cells = "".join(f"{'>100,000' if k is None else f'{k:,}':>9}" for k in needed)
                sd = effective_deviation(sample)
                rows.append(
                    f"{f'{depth:g} m':>6}  {environment:<22} {QUANTITY_WORDS[quantity]:<9} {n:>4} {sd:>7.2f}{cells}"
                )
                any_nested |= nested(sample)
    if not rows:
        raise PuddleError(f"study {study.name} has no arm with two champions, so no deviation over trials is known")
    yield f"study {study.name}: trials of each arm that show a difference of means with a probability of {power:.0%}"
    heading = "".join(f"{f'{difference:g} m':>9}" for difference in differences)
    yield f"{'depth':>6}  {'evolved in':<22} {'':<9} {'n':>4} {'SD [m]':>7}{heading}"
    yield from rows
    if any_nested:
        n_replicates = study.settings.replicates
        caution = " From two replicates that variance is hardly known: take three to five." if n_replicates == 2 else ""
        yield (
            f"Trials of arms with networks belong to {n_replicates} replicates. Their SD includes the variance between "
            f"replicates, and more trials are those of more replicates, each with as many trials as here.{caution}"
        )
