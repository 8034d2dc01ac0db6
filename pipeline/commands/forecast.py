"""puddle forecast: the time and the disk that the rest of a study takes."""

from typing import Annotated

import typer

from pipeline.cluster.process import number_of_cores
from pipeline.commands.options import StudyOptions, with_options
from pipeline.commands.terminal import to_stdout
from pipeline.commands.time_model import UNMEASURED, forecast_stages

_HOUR = 3600.0


@with_options
def forecast(
    options: StudyOptions,
    cores: Annotated[
        int | None, typer.Option("--cores", min=1, help="Cores to forecast for; this machine's by default.")
    ] = None,
) -> None:
    """Estimate time and disk of the rest of a study.

    By what the store measured of such work, or else by a table; right within a factor of two.
    """
    settings = options.settings()
    stages = forecast_stages(settings, options.find_store())
    n_cores = cores or number_of_cores()
    to_stdout(f"study {settings.name}: the rest of the work on {n_cores:,} core{'s' * (n_cores > 1)}")
    to_stdout(f"{'stage':<9}{'work':>19}{'core time':>11}{'time':>9}{'disk':>9}  cost from")
    for one in stages:
        work = f"{one.n_units:,.0f} {one.unit}" if one.n_units >= 1 else "< 1 unit" if one.n_units else "done"
        taken = f"{_time(one.core_seconds):>11}{_time(one.seconds(n_cores)):>9}{_size(one.n_bytes):>9}"
        to_stdout(f"{one.stage:<9}{work:>19}{taken}  {one.source}".rstrip())
    core_seconds, seconds = sum(one.core_seconds for one in stages), sum(one.seconds(n_cores) for one in stages)
    n_bytes = sum(one.n_bytes for one in stages)
    lacking = f"  without what is {UNMEASURED}" * any(UNMEASURED in one.source for one in stages)
    to_stdout(f"{'all':<28}{_time(core_seconds):>11}{_time(seconds):>9}{_size(n_bytes):>9}{lacking}")


def _time(seconds: float) -> str:
    """Write a time in the unit that a person would use, so that a short one is not 0.00 h."""
    if seconds < 100:
        return f"{seconds:.0f} s" if seconds >= 1 else "< 1 s" if seconds > 0 else "-"
    if seconds < 100 * 60:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / _HOUR:.1f} h" if seconds < 100 * _HOUR else f"{seconds / _HOUR:,.0f} h"


def _size(n_bytes: float) -> str:
    if n_bytes >= 1e10:
        return f"{n_bytes / 1e9:,.0f} GB"
    return f"{n_bytes / 1e6:.0f} MB" if n_bytes >= 1e6 else "< 1 MB" if n_bytes > 0 else "-"
