"""Commands that look after machines and stores: puddle doctor, verify, gc and forecast."""

from contextlib import nullcontext
from typing import Annotated

import typer

from pipeline.commands.options import DEFAULT_STORE, StorePath, StudyOptions, Workers, with_options
from pipeline.commands.terminal import INCOMPLETE, to_stdout

_HOUR = 3600.0


@with_options
def doctor(options: StudyOptions, workers: Workers = None) -> None:
    """Check a machine before a long study."""
    from pipeline.commands.examination import examine

    checks = []
    for check in examine(options.settings(), options.store, n_workers=workers):
        checks.append(check)
        to_stdout(f"{check.verdict:<5} {check.what}: {check.found}")
        if check.verdict != "ok":
            to_stdout(f"      {check.advice}")
    if any(check.verdict == "fail" for check in checks):
        raise typer.Exit(INCOMPLETE)


@with_options
def verify(
    store: StorePath = DEFAULT_STORE,
    discard: Annotated[
        bool, typer.Option("--discard", help="Remove damaged items; the next run computes them again.")
    ] = False,
) -> None:
    """Hash a store again; name what is damaged."""
    from pipeline.errors import DamagedArtifact
    from pipeline.workflow.progress import progress

    options = StudyOptions(store=store)
    opened = options.open_store()
    with opened.lock_all() if discard else nullcontext(), progress() as show:
        n_items = len(list(opened.items()))
        with show.stage("verify", total=n_items) as advance:
            wrong = opened.verify(checked=lambda: advance(1))
        damaged = [(one.stage, one.key) for one in wrong if isinstance(one, DamagedArtifact) and one.stage and one.key]
        for stage, key in damaged if discard else ():
            opened.discard(stage, key)
    if not wrong:
        to_stdout(f"{opened.root}: {n_items:,} items: every byte is as it was committed.")
        return
    to_stdout(*map(str, wrong), f"{opened.root}: {len(wrong)} problems in {n_items:,} items.")
    if damaged and discard:
        to_stdout(f"What is damaged is discarded: `{options.command('study')}` computes it again.")
    elif damaged:
        discarding = f"`{options.command('verify')} --discard`"
        to_stdout(f"{discarding} removes what is damaged; then `{options.command('study')}` computes it again.")
    raise typer.Exit(INCOMPLETE)


@with_options
def gc(
    store: StorePath = DEFAULT_STORE,
    remove: Annotated[bool, typer.Option("--remove", help="Remove the garbage; without it, only list it.")] = False,
) -> None:
    """List what no study of a store needs, or remove it."""
    from pipeline.commands.garbage import find_garbage, garbage_lines

    options = StudyOptions(store=store)
    opened = options.open_store()
    with opened.lock_all():
        garbage = find_garbage(opened)
        lines = list(garbage_lines(opened, garbage, removed=remove, command=f"{options.command('gc')} --remove"))
        for item in garbage if remove else ():
            opened.discard(*item)
    to_stdout(*lines)


@with_options
def forecast(
    options: StudyOptions,
    cores: Annotated[
        int | None, typer.Option("--cores", min=1, help="Cores to forecast for; this machine's by default.")
    ] = None,
    gpu_tflops: Annotated[
        float | None,
        typer.Option("--gpu-tflops", min=0.001, help="Rate at which a GPU trains, for its time [TFLOP/s]."),
    ] = None,
    gpu_price: Annotated[float, typer.Option("--gpu-price", min=0.0, help="Price of an hour of that GPU.")] = 0.0,
) -> None:
    """Estimate time and disk of the rest of a study.

    By what the store measured of such work, or else by a table; right within a factor of two.
    """
    from pipeline.cluster.process import number_of_cores
    from pipeline.commands.time_model import forecast_stages, training_gpu_seconds
    from pipeline.errors import PuddleError

    if gpu_price and not gpu_tflops:
        raise PuddleError("--gpu-price: expected with --gpu-tflops, which tells the time")
    settings = options.settings()
    stages = forecast_stages(settings, options.find_store())
    n_cores = cores or number_of_cores()
    gpu_hours = training_gpu_seconds(settings, gpu_tflops) / _HOUR if gpu_tflops else None
    to_stdout(f"study {settings.name}: the rest of the work on {n_cores:,} core{'s' * (n_cores > 1)}")
    to_stdout(f"{'stage':<9}{'work':>19}{'core time':>11}{'time':>9}{'disk':>9}  cost from")
    for one in stages:
        work = f"{one.n_units:,.0f} {one.unit}" if one.n_units >= 1 else "< 1 unit" if one.n_units else "done"
        taken = f"{_time(one.core_seconds):>11}{_time(one.seconds(n_cores)):>9}{_size(one.n_bytes):>9}"
        to_stdout(f"{one.stage:<9}{work:>19}{taken}  {one.source}".rstrip())
    core_seconds, seconds = sum(one.core_seconds for one in stages), sum(one.seconds(n_cores) for one in stages)
    n_bytes = sum(one.n_bytes for one in stages)
    to_stdout(f"{'all':<28}{_time(core_seconds):>11}{_time(seconds):>9}{_size(n_bytes):>9}")
    if gpu_hours is not None:
        price = f", {gpu_hours * gpu_price:,.2f} at {gpu_price:g} an hour" if gpu_price else ""
        to_stdout(f"all networks on a GPU at {gpu_tflops:g} TFLOP/s: {gpu_hours:.2g} hours{price}")


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
