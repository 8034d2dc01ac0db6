"""Commands that look after machines and stores: puddle doctor, verify, gc and forecast."""

from dataclasses import asdict
from typing import Annotated

import typer

from pipeline.commands.options import DEFAULT_STORE, AsJson, StorePath, StudyOptions, Workers, with_options
from pipeline.commands.terminal import INCOMPLETE, interruptible, print_json, to_stdout

_HOUR = 3600.0


@with_options
def doctor(options: StudyOptions, workers: Workers = None, as_json: AsJson = False) -> None:
    """Check a machine before a long study."""
    from pipeline.commands.examination import examine

    checks = []
    with interruptible():
        for check in examine(options.settings(), options.store, n_workers=workers):
            checks.append(check)
            if not as_json:
                to_stdout(f"{check.verdict:<5} {check.what}: {check.found}")
                if check.advice:
                    to_stdout(f"      {check.advice}")
    failed = any(check.verdict == "fail" for check in checks)
    if as_json:
        print_json({"ok": not failed, "checks": [asdict(check) for check in checks]})
    if failed:
        raise typer.Exit(INCOMPLETE)


@with_options
def verify(
    options: StudyOptions,
    discard: Annotated[
        bool, typer.Option("--discard", help="Remove damaged items; the next run computes them again.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Hash a store, or one study, again; name what is damaged."""
    from pipeline.commands import damage
    from pipeline.workflow.progress import progress

    if options.study is not None:
        options.settings()  # refuses a name that is unknown, and a record that is damaged
    store = options.open_store()
    with interruptible(), store.lock_all() if discard else store.lock_to_read(), progress() as show:
        found = damage.verify(store, options.study, discard=discard, progress=show)
    if as_json:
        print_json({**asdict(found), "intact": found.intact})
    else:
        to_stdout(*damage.verification_lines(found, how_to_run=options.command))
    if not found.intact:
        raise typer.Exit(INCOMPLETE)


@with_options
def gc(
    store: StorePath = DEFAULT_STORE,
    remove: Annotated[bool, typer.Option("--remove", help="Remove the garbage; without it, only list it.")] = False,
) -> None:
    """List what no study of a store needs, or remove it."""
    from pipeline.commands.garbage import find_garbage, garbage_lines, remove_garbage

    options = StudyOptions(store=store)
    opened = options.open_store()
    with opened.lock_all():
        found = find_garbage(opened)
        lines = list(garbage_lines(opened, found, removed=remove, command=f"{options.command('gc')} --remove"))
        if remove:
            remove_garbage(opened, found)
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
    as_json: AsJson = False,
) -> None:
    """Estimate time and disk of the rest of a study.

    By what the store measured of such work, or else by a table; right within a factor of two.
    """
    from pipeline.cluster.process import number_of_cores
    from pipeline.commands.time_model import forecast_stages, training_gpu_seconds

    settings = options.settings()
    with interruptible():
        stages = forecast_stages(settings, options.find_store())
    n_cores = cores or number_of_cores()
    gpu_hours = training_gpu_seconds(settings, gpu_tflops) / _HOUR if gpu_tflops else None
    if as_json:
        rows = [{**asdict(one), "seconds": one.seconds(n_cores)} for one in stages]
        print_json({"study": settings.name, "n_cores": n_cores, "stages": rows, "gpu_hours": gpu_hours})
        return
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
