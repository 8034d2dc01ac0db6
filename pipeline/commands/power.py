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

_DIFFERENCES = (1.0, 2.0, 5.0)  # [m]


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
    """
    from pipeline.results.recorded_study import open_study

    for line in power_lines(open_study(study, store), differences or _DIFFERENCES, probability):
        to_stdout(line)


def power_lines(study: "Study", differences: Sequence[float], power: float) -> Iterator[str]:
    """Yield a row for each arm: its deviation over trials, and the trials per arm that each difference needs.

    Args:
        study: a recorded study.
        differences: differences of means [m].
        power: probability of showing them.

    Raises:
        PuddleError: a difference or the power is out of range, or no arm has two champions.
    """
    import numpy as np

    from tasks.analysis.statistical_power import n_trials_for

    if not 0 < power < 1:
        raise PuddleError(f"--power: expected a probability between 0 and 1, got {power:g}")
    for difference in differences:
        if not (math.isfinite(difference) and difference > 0):
            raise PuddleError(f"--difference: expected a difference above 0 m, got {difference:g}")
    champions = study.champions().to_pylist()
    arms = dict.fromkeys((row["depth"], row["environment"]) for row in champions)
    rows = []
    for depth, environment in sorted(arms, key=lambda arm: -arm[0]):
        for quantity, words in (("zero_shot", "zero-shot"), ("adapted", "adapted")):
            arm = [row[quantity] for row in champions if (row["depth"], row["environment"]) == (depth, environment)]
            known = [value for value in arm if value is not None and math.isfinite(value)]
            if len(known) > 1:
                sd = float(np.std(known, ddof=1))
                needed = (n_trials_for(difference, sd, power=power) for difference in differences)
                cells = "".join(f"{'> 100,000' if n is None else f'{n:,}':>10}" for n in needed)
                rows.append(f"{f'{depth:g} m':>7}  {environment:<16} {words:<9} {len(known):>4} {sd:>7.2f}{cells}")
    if not rows:
        raise PuddleError(f"study {study.name} has no arm with two champions, so no deviation over trials is known")
    yield f"study {study.name}: trials of each arm that show a difference of means with a probability of {power:.0%}"
    heading = "".join(f"{f'{difference:g} m':>10}" for difference in differences)
    yield f"{'depth':>7}  {'evolved in':<16} {'':<9} {'n':>4} {'SD [m]':>7}{heading}"
    yield from rows
    if study.settings.replicates > 1:
        yield (
            f"Trials count as independent. Those with networks share {study.settings.replicates} data sets, so they "
            "may need more data sets, not more trials: the table variance splits their variance."
        )
