"""The command line: one command per stage, the whole study, and what a person asks about it."""

from __future__ import annotations

import contextlib
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.cluster import Cluster, pin_threads, ray_cluster, serial_cluster
from pipeline.commands.options import (
    DEFAULT_PRESET,
    DEFAULT_STORE,
    Address,
    Chosen,
    Overrides,
    Preset,
    SettingsFile,
    StorePath,
    TrackingUri,
    Workers,
)
from pipeline.errors import PuddleError

USER_ERROR = 2
"""Exit code of a mistake that the user can mend."""
INCOMPLETE = 1
"""Exit code of a study that went to its end without some of its work or designs, which the message names."""
DEFECT = 70
"""Exit code of a mistake of puddle's own, which its traceback shows: EX_SOFTWARE of sysexits.h. Python's would be 1."""
INTERRUPTED = 130
"""Exit code after Ctrl-C."""
STOPPED = (128 + signal.SIGTERM, 128 + signal.SIGHUP)
"""Exit codes after SIGTERM, and after a closed terminal."""

app = typer.Typer(
    help="Evolve robots for a world whose physics the simulator lacks.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _run(
    chosen: Chosen, names: tuple[str, ...], workers: int | None, address: str | None, tracking_uri: str | None
) -> None:
    """Run stages by name, or all of them."""
    from pipeline.stages import STAGES
    from pipeline.tracking.mirror import open_tracker
    from pipeline.workflow.driver import drive
    from pipeline.workflow.progress import progress

    settings = chosen.settings()
    store = chosen.open_store(create=True)
    with _interruptible(), progress() as show:
        upstream = drive(
            settings,
            [stage for stage in STAGES if not names or stage.name in names],
            store=store,
            open_cluster=_cluster(workers, address),
            tracker=open_tracker(store.root, tracking_uri, say=show.say),
            progress=show,
            how_to_run=chosen.command,
        )
    lost = [f"{name}: {label}: {why}" for name, found in upstream.items() for label, why in found.failed.items()]
    wild = [f"{name}: {label}: {what}" for name, found in upstream.items() for label, what in found.diverged.items()]
    if lost:
        _to_stderr("\n".join([f"{len(lost)} pieces of work were set aside; the rest is done:", *lost]))
    if wild:
        _to_stderr("\n".join(["Designs diverged and were set aside; the rest is done:", *wild, _WHAT_TO_DO]))
    if lost or wild:
        raise typer.Exit(INCOMPLETE)


_WHAT_TO_DO = (
    "Rollouts in a sound world stay finite: look at the settings of physics and slush, and at the networks' errors on\n"
    "the page. The same settings give the same again; all that is done is safe."
)
"""Where designs diverged."""


def _check_where(context: typer.Context, workers: int | None, address: str | None) -> None:
    """Refuse workers here beside a cluster elsewhere; an address in the environment is only a default."""
    source = context.get_parameter_source("address")
    if workers is not None and address not in (None, "local") and source is not None and source.name == "COMMANDLINE":
        raise PuddleError(
            f"--workers: expected without --address, whose cluster has the cores that it has; came --workers {workers} "
            f"with --address {address}"
        )


def _cluster(workers: int | None, address: str | None) -> Callable[[], AbstractContextManager[Cluster]]:
    """Choose where work is done. Workers are this machine's, so that an address in the environment does not count."""
    if workers == 0:
        return serial_cluster
    return lambda: ray_cluster(address=address if workers is None else "local", n_workers=workers)


@contextlib.contextmanager
def _interruptible() -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        _say_stopped()
        raise typer.Exit(INTERRUPTED) from None
    except SystemExit as stop:
        if stop.code in STOPPED:
            _say_stopped()
        raise


def _say_stopped() -> None:
    with contextlib.suppress(OSError):  # a closed terminal
        _to_stderr("\nStopped. What is done is kept: the same command goes on from there.")


def _add_stage_command(name: str, summary: str, stages: tuple[str, ...]) -> None:
    @app.command(name=name, help=summary)
    def command(
        context: typer.Context,
        preset: Preset = DEFAULT_PRESET,
        settings: SettingsFile = None,
        overrides: Overrides = None,
        store: StorePath = DEFAULT_STORE,
        workers: Workers = None,
        address: Address = None,
        tracking_uri: TrackingUri = None,
    ) -> None:
        _check_where(context, workers, address)
        chosen = Chosen(preset, settings, tuple(overrides or ()), store)
        _run(chosen, stages, workers, address, tracking_uri)


for _name, _summary in {
    "collect": "Throw rectangles into slush and keep what the base simulator gets wrong.",
    "train": "Train the ensemble of residual networks on the throws.",
    "evolve": "Evolve designs in every environment, at every depth.",
    "transfer": "Score champions in True Slush, zero-shot and with adapted controllers.",
    "assess": "Put the networks' predictions of designs beside what truly happens.",
    "analyse": "Compute statistics, the table against the paper, and where the networks hallucinate.",
    "report": "Make the page that shows what came of it.",
}.items():
    _add_stage_command(_name, _summary, (_name,))
_add_stage_command("study", "Run every stage that is not done yet, and show what came of it.", ())


@app.command()
def status(
    preset: Preset = DEFAULT_PRESET,
    settings: SettingsFile = None,
    overrides: Overrides = None,
    store: StorePath = DEFAULT_STORE,
    digests: Annotated[bool, typer.Option("--digests", help="Print the SHA-256 of all that is done.")] = False,
) -> None:
    """Say what of a study is done, running and missing."""
    from pipeline.commands.status import digest_lines, status_lines

    chosen = Chosen(preset, settings, tuple(overrides or ()), store)
    lines = digest_lines if digests else status_lines
    for line in lines(chosen.settings(), chosen.open_store(create=False)):
        typer.echo(line)


@app.command(name="settings")
def list_settings(preset: Preset = DEFAULT_PRESET, settings: SettingsFile = None, overrides: Overrides = None) -> None:
    """List every setting with its unit, its reason and its value: a file to begin your own from."""
    from pipeline.config.annotated import annotated_lines

    for line in annotated_lines(Chosen(preset, settings, tuple(overrides or ()), DEFAULT_STORE).settings()):
        typer.echo(line)


@app.command()
def forecast(
    preset: Preset = DEFAULT_PRESET,
    settings: SettingsFile = None,
    overrides: Overrides = None,
    store: StorePath = DEFAULT_STORE,
    cores: Annotated[
        list[int] | None, typer.Option("--cores", min=1, help="Also say it for so many cores like this machine's.")
    ] = None,
) -> None:
    """Say how long a study will take, from rates measured on this machine now, and how much it will keep."""
    from pipeline.commands.forecast import forecast_lines

    chosen = Chosen(preset, settings, tuple(overrides or ()), store)
    with _interruptible():
        for line in forecast_lines(chosen.settings(), store, tuple(cores or ()), say=_to_stderr):
            typer.echo(line)


@app.command()
def simulate(
    design: Annotated[Path, typer.Argument(help="A design file (design.json).")],
    environment: Annotated[str, typer.Option("--environment", help="dry_land, true_slush or residual_slush.")],
    depth: Annotated[float, typer.Option("--depth", help="Of the ground below the surface [m].")],
    out: Annotated[Path | None, typer.Option("--out", help="A film (.gif, .mp4) or a page (.html) of it.")] = None,
    preset: Preset = DEFAULT_PRESET,
    settings: SettingsFile = None,
    overrides: Overrides = None,
    store: StorePath = DEFAULT_STORE,
) -> None:
    """Simulate one design, say how far it gets, and show it.

    The settings say how long it is watched; residual_slush takes the networks that the store holds for them. So does a
    page, in any world: its colours show where the networks disagree, and how far from the throws the robot strays.
    """
    from pipeline.commands.simulate import simulate_design

    chosen = Chosen(preset, settings, tuple(overrides or ()), store)
    lines = simulate_design(
        design,
        environment,
        depth,
        out,
        settings=chosen.settings(),
        open_store=lambda: chosen.open_store(create=False),
        how_to_run=chosen.command,
    )
    for line in lines:
        typer.echo(line)


@app.command()
def fabricate(
    design: Annotated[Path | None, typer.Argument(help="A design file (design.json).")] = None,
    study: Annotated[str | None, typer.Option("--study", help="Or a study, whose proposed champion is taken.")] = None,
    out: Annotated[Path, typer.Option("--out", help="The kit's folder: a new one, or a kit to replace.")] = Path("kit"),
    settings: Annotated[Path | None, typer.Option("--settings", help="A file of the kit's own settings.")] = None,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", help="Change one: kit.servo=mg90s, kit.bed_mm=[180,180,180].")
    ] = None,
    preset: Annotated[
        str | None, typer.Option("--preset", help="How a design file is simulated; pontoon by default.")
    ] = None,
    store: StorePath = DEFAULT_STORE,
    tracking_uri: TrackingUri = None,
) -> None:
    """Make the kit of a robot: parts to print, a bill, drawings, the scale's physics, the servos' timeline.

    The exit code is 1 where something speaks against building it.
    """
    from pipeline.config.loading import load, parse
    from pipeline.fabrication.choices import FabricationSettings
    from pipeline.fabrication.make_kit import fabricate as make
    from pipeline.tracking.mirror import open_tracker
    from pipeline.workflow.driver import settings_of

    if (design is None) == (study is None):
        raise PuddleError("expected a design file or --study NAME, one of them: `puddle fabricate design.json`")
    if study is not None and preset is not None:
        raise PuddleError(
            f"--preset: expected with a design file, came with --study {study}, whose champion is "
            f"simulated under the study's own settings"
        )
    choices = tuple(overrides or ())
    chosen = (
        load(FabricationSettings, settings, choices)
        if settings is not None
        else parse(FabricationSettings, "", name="the kit's settings", overrides=choices)
    )
    shared = Chosen(preset or "pontoon", None, (), store)
    opened = shared.open_store(create=study is None)
    if study is None:
        of_study = shared.settings()
    elif (record := opened.read_study(study)) is None:
        raise PuddleError(f"--study: {store} holds no study of the name {study!r}")
    else:
        of_study = settings_of(record)
    with _interruptible():
        made = make(
            design, of_study, chosen, out, store=opened, tracker=open_tracker(opened.root, tracking_uri, say=_to_stderr)
        )
    for line in made.lines:
        typer.echo(line)
    if made.faults:
        raise typer.Exit(INCOMPLETE)


@app.command()
def drive(
    timeline: Annotated[
        Path | None, typer.Argument(help="A kit that `puddle fabricate` made, or a timeline (timeline.json).")
    ] = None,
    port: Annotated[str | None, typer.Option("--port", help="Of the servo controller: /dev/ttyACM0.")] = None,
    list_ports: Annotated[bool, typer.Option("--list-ports", help="List this machine's serial ports.")] = False,
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help="Of the servos; calibration.yaml beside the timeline else.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Do everything but talk to a controller.")] = False,
    duration: Annotated[float | None, typer.Option("--duration", help="Stop after so many seconds.")] = None,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end, until stopped.")] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Move without asking first.")] = False,
    log: Annotated[
        Path | None, typer.Option("--log", help="Where to write what was sent (Parquet); beside the timeline else.")
    ] = None,
    baud: Annotated[int, typer.Option("--baud", min=300, max=200_000, help="Of a wired port; USB has none.")] = 115200,
    baud_detection: Annotated[
        bool, typer.Option("--baud-detection", help="The controller is set to detect the baud rate: send 0xAA first.")
    ] = False,
    timeout: Annotated[
        float,
        typer.Option("--timeout", min=0.01, help="Longest wait for the controller's answer [s]; more on a slow line."),
    ] = 0.1,
) -> None:
    """Move a robot's servos through a timeline, and bring them back to rest whatever happens (docs/servo.md)."""
    from pipeline.servo import play

    if list_ports:
        for line in play.port_lines():
            typer.echo(line)
        return
    if timeline is None:
        raise PuddleError("expected a kit or a timeline to play: `puddle drive kit --port ...`, or --list-ports")
    options = play.PlayOptions(timeline, calibration, port, dry_run, duration, loop, log, baud, baud_detection, timeout)
    if not play.play_timeline(options, confirm=lambda question: yes or _confirmed(question), say=typer.echo):
        raise typer.Exit(INTERRUPTED)


def _confirmed(question: str) -> bool:
    try:
        return typer.confirm(question)
    except typer.Abort:  # Ctrl-C, or nobody there to answer
        return False


@app.command()
def verify(
    preset: Preset = DEFAULT_PRESET,
    settings: SettingsFile = None,
    overrides: Overrides = None,
    store: StorePath = DEFAULT_STORE,
    discard: Annotated[bool, typer.Option("--discard", help="Forget what is damaged: a run mends it.")] = False,
) -> None:
    """Hash everything in a store again; name what is damaged, and what mends it."""
    from pipeline.commands.verify import verify_lines
    from pipeline.workflow.progress import progress

    chosen = Chosen(preset, settings, tuple(overrides or ()), store)
    kept = chosen.open_store(create=False)
    with _interruptible(), kept.lock_all() if discard else contextlib.nullcontext(), progress() as show:
        lines, well = verify_lines(kept, discard=discard, progress=show, how_to_run=chosen.command)
    typer.echo("\n".join(lines))
    if not well:
        raise typer.Exit(INCOMPLETE)


@app.command()
def gc(
    store: StorePath = DEFAULT_STORE,
    remove: Annotated[bool, typer.Option("--remove", help="Remove it; otherwise it is only listed.")] = False,
) -> None:
    """List what no study of a store needs and what killed drivers left, or remove it."""
    from pipeline.commands import gc as garbage

    chosen = Chosen(DEFAULT_PRESET, None, (), store)
    kept = chosen.open_store(create=False)
    with kept.lock_all():
        found = garbage.find_garbage(kept)
        lines = list(garbage.gc_lines(kept, found, removed=remove, command=f"{chosen.command('gc')} --remove"))
        if remove:
            garbage.remove(kept, found)
    typer.echo("\n".join(lines))


@app.command()
def doctor(
    preset: Preset = DEFAULT_PRESET,
    settings: SettingsFile = None,
    overrides: Overrides = None,
    store: StorePath = DEFAULT_STORE,
    workers: Workers = None,
) -> None:
    """Check this machine before a long study: versions, disk, memory, permissions, processor, Ray."""
    from pipeline.commands.doctor import examine

    chosen = Chosen(preset, settings, tuple(overrides or ()), store)
    with _interruptible():
        failed = False
        for finding in examine(chosen.settings(), store, n_workers=workers):
            failed = failed or finding.verdict == "fail"
            typer.echo(f"{finding.verdict:<5} {finding.what}: {finding.found}")
            if finding.advice:
                typer.echo(f"      {finding.advice}")
    if failed:
        raise typer.Exit(INCOMPLETE)


@app.command()
def ui(
    store: StorePath = DEFAULT_STORE,
    port: Annotated[int, typer.Option("--port", min=1, max=65535, help="On this machine's loopback.")] = 5000,
) -> None:
    """Open the MLflow UI on this machine's loopback."""
    from pipeline.tracking.mirror import serve_ui

    chosen = Chosen(DEFAULT_PRESET, None, (), store)
    with _interruptible():
        serve_ui(chosen.open_store(create=False).root, port)


def _to_stderr(line: str) -> None:
    typer.echo(line, err=True)


def main(arguments: list[str] | None = None) -> Any:
    """Run the command line.

    A mistake that the user can mend ends in one message and exit code 2, one of puddle's own in a traceback and 70.
    """
    pin_threads()
    try:
        return app(arguments)
    except PuddleError as error:
        typer.echo(f"puddle: {error}", err=True)
        sys.exit(USER_ERROR)
    except Exception:
        traceback.print_exc()
        sys.exit(DEFECT)
