"""The table of `puddle forecast`."""

from collections.abc import Iterator

from pipeline.commands.cost_model import StudyForecast

_NOTICEABLE = 0.05  # share of a study's time from which on a stage's limit is named


def forecast_lines(forecast: StudyForecast) -> Iterator[str]:
    """Tabulate a forecast, and say what limits it; with one further number of cores, it is 80 columns wide."""
    yield f"study {forecast.study}: the rest of the work"
    header = "".join(f"{_cores(n):>{_column(n)}}" for n in forecast.n_cores)
    yield f"{'stage':<9}{'work':>19}{'core time':>11}{header}{'disk':>9}  cost from"
    for stage in forecast.stages:
        work = f"{stage.n_units:,.0f} {stage.unit}" if stage.n_units >= 1 else "< 1 unit" if stage.n_units else "done"
        times = "".join(f"{_time(forecast.stage_seconds(stage, n)):>{_column(n)}}" for n in forecast.n_cores)
        taken = f"{_time(stage.core_seconds)}{' GPU' if stage.n_gpus and stage.n_units else ''}"
        line = f"{stage.stage:<9}{work:>19}{taken:>11}{times}{_size(stage.n_bytes):>9}"
        yield f"{line}  {stage.source}".rstrip()
    core_seconds = sum(stage.core_seconds for stage in forecast.stages if not stage.n_gpus)
    n_bytes = sum(stage.n_bytes for stage in forecast.stages)
    times = "".join(f"{_time(forecast.seconds(n)):>{_column(n)}}" for n in forecast.n_cores)
    yield f"{'all':<28}{_time(core_seconds):>11}{times}{_size(n_bytes):>9}"
    n_items, traffic = sum(s.n_items for s in forecast.stages), sum(s.traffic for s in forecast.stages)
    if n_items:
        driver = forecast.driver
        yield (
            f"driver: {n_items:,} items at {1e3 * driver.seconds_per_item:g} ms and {1e9 * driver.seconds_per_byte:g} "
            f"ms/MB; at most {_size(traffic)} to and from workers at {8e-9 * driver.bytes_per_second:g} Gbit/s"
        )
        yield from _limit_lines(forecast)
    if forecast.store_bytes is not None:
        yield f"The store holds {_size(forecast.store_bytes)} now."


def _limit_lines(forecast: StudyForecast) -> Iterator[str]:
    """Say what limits the stages that take a noticeable share of the time, for further numbers of cores."""
    for n in forecast.n_cores[1:]:
        limited: dict[str, list[str]] = {}
        for stage in forecast.stages:
            if forecast.stage_seconds(stage, n) >= _NOTICEABLE * forecast.seconds(n):
                limited.setdefault(forecast.limit(stage, n), []).append(stage.stage)
        words = (f"{what} ({', '.join(stages)})" for what, stages in limited.items())
        yield f"{_cores(n)}: limited by {'; '.join(words)}"


def _cores(n: int) -> str:
    return f"{n:,} core" + "s" * (n > 1)


def _column(n_cores: int) -> int:
    """Return the width of a column of the table, with a space before its heading."""
    return max(10, 1 + len(_cores(n_cores)))


def _time(seconds: float) -> str:
    """Write a time in the unit that a person would use, so that a short one is not 0.00 h."""
    if seconds <= 0:
        return "-"
    if seconds < 100:
        return f"{seconds:.0f} s" if seconds >= 1 else "< 1 s"
    if seconds < 6000:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h" if seconds < 360_000 else f"{seconds / 3600:,.0f} h"


def _size(n_bytes: float) -> str:
    if n_bytes <= 0:
        return "-"
    if n_bytes >= 1e10:
        return f"{n_bytes / 1e9:,.0f} GB"
    return f"{n_bytes / 1e6:.0f} MB" if n_bytes >= 1e6 else "< 1 MB"
