"""The options that commands share, declared once."""

from __future__ import annotations

import functools
import inspect
import json
import os
import shlex
import shutil
import sysconfig
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from pipeline.cluster import Cluster, ray_cluster, serial_cluster
from pipeline.cluster.process import check_limits, number_of_cores
from pipeline.errors import PuddleError

if TYPE_CHECKING:
    from pipeline.config.settings import Settings
    from pipeline.store.store import Store, StudyRecord

_DEFAULT_PRESET = "laptop"
_STORE_VARIABLE = "PUDDLE_STORE"
DEFAULT_STORE = Path("store")


_A_STUDY = "A study of the store: its recorded settings and results."
StorePath = Annotated[Path, typer.Option("--store", envvar=_STORE_VARIABLE, help="The folder that holds results.")]
StudyArgument = Annotated[str, typer.Argument(metavar="NAME", help=_A_STUDY)]
OptionalStudy = Annotated[str | None, typer.Argument(metavar="[NAME]", help=_A_STUDY)]
StudyName = Annotated[str | None, typer.Option("--study", metavar="NAME", help=_A_STUDY)]
Workers = Annotated[
    int | None, typer.Option("--workers", min=0, help="Cores of this machine to use; default all, 0 runs without Ray.")
]
TrackingUri = Annotated[
    str | None,
    typer.Option("--tracking-uri", envvar="MLFLOW_TRACKING_URI", help="An MLflow server; default a file in the store."),
]
Extensions = Annotated[
    list[Path] | None,
    typer.Option("--with", help="A file of your own that registers a medium, a form, a controller, a search, …"),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document, for programs.")]
MARKERS_OPTION = typer.Option("--markers", help="Which tag is where: markers.yaml of a throwing kit.")
LensVideo = Annotated[
    Path | None, typer.Option("--lens", help="A video of the printed board, which calibrates the lens.")
]
Slowdown = Annotated[
    float,
    typer.Option(
        "--slowdown", min=0.01, help="Factor by which the video is slowed down: 8 for 240 frames/s that play at 30."
    ),
]


def to_copy(command: str, store: Path) -> str:
    """Return a command line to copy: with the program as it is found here, and the store unless it is the default."""
    own, found = Path(sysconfig.get_path("scripts")) / "puddle", shutil.which("puddle")
    program = "puddle"  # in an active environment
    if own.exists() and (found is None or not own.samefile(found)):
        program = shlex.quote(str(own.relative_to(Path.cwd()) if own.is_relative_to(Path.cwd()) else own))
    is_default = store == Path(os.environ.get(_STORE_VARIABLE) or DEFAULT_STORE)
    return f"{program} {command}" + ("" if is_default else f" --store {shlex.quote(str(store))}")


def output_suffix(out: Path, suffixes: Sequence[str], *, replaces: bool = True) -> str:
    """Return which suffix the file of --out has; refuse a path that can't be one before anything is computed."""
    fits = out.parent.is_dir() and (not out.exists() or (replaces and out.is_file()))
    if out.suffix.lower() not in suffixes or not fits:
        kind = "file" if replaces else "new file"
        raise PuddleError(
            f"--out: expected a {kind} that ends in {' or '.join(suffixes)}, in an existing folder, got {out}"
        )
    return out.suffix.lower()


@dataclass(frozen=True)
class SettingsOptions:
    """Options that choose the settings of a study, and the store that holds its results."""

    study: StudyName = None
    preset: Annotated[
        str | None,
        typer.Option(
            "--preset", help="Settings in configs/, such as smoke; laptop by default. A wrong name lists them all."
        ),
    ] = None
    settings_file: Annotated[Path | None, typer.Option("--settings", help="A settings file, not a preset.")] = None
    overrides: Annotated[
        list[str] | None, typer.Option("--set", help="Change one setting, for example evolution.n_generations=50.")
    ] = None
    tracks: Annotated[
        Path | None,
        typer.Option("--tracks", help="Learn from these tracked throws (.csv or .parquet), not from simulated ones."),
    ] = None
    extensions: Extensions = None
    store: StorePath = DEFAULT_STORE

    def __post_init__(self) -> None:
        """Refuse more than one source of settings."""
        options = {"study": self.study, "--preset": self.preset, "--settings": self.settings_file}
        if len(given := [f"{option} {value}" for option, value in options.items() if value is not None]) > 1:
            raise PuddleError(
                f"expected only one of a study's name, --preset and --settings, got {' with '.join(given)}"
            )

    def settings(self, *, to_compute: bool = True) -> Settings:
        """Load the settings: those on record for a study that is named, else those of a file or a preset.

        Tracks that they name are read, so that the settings know their digests. Code that a study on record used may be
        missing unless it is ``to_compute``.
        """
        from pipeline.config.loading import load, parse, preset_path
        from pipeline.config.settings import RecordedSettings, Settings
        from pipeline.stages.tracked import with_tracks
        from pipeline.workflow.record import settings_of
        from tasks.discovery import with_failures

        overrides = list(self.overrides or ())
        if self.tracks and any(override.startswith("tracks.") for override in overrides):
            # Settings of tracks are valid only beside the file.
            overrides = ["throws.source=tracks", f"tracks.file={json.dumps(str(self.tracks))}", *overrides]
        if self.study is None:
            chosen = load(Settings, self.settings_file or preset_path(self._preset), overrides)
        else:
            chosen = settings_of(self._record(self.study))
            if isinstance(chosen, RecordedSettings) and (to_compute or overrides):
                mistake = f"study {self.study}: expected the code of {', '.join(chosen.missing)}, found none"
                raise PuddleError(with_failures(mistake))
            if overrides:
                text, name = chosen.model_dump_json(), f"the settings of study {self.study}"
                chosen = parse(Settings, text, name=name, overrides=overrides)
        return with_tracks(chosen, self.tracks)

    @property
    def source(self) -> str:
        """Where the settings come from, for the study's record: "preset laptop", or the path of a settings file."""
        if self.study is not None:
            return self._record(self.study).source
        return str(self.settings_file.resolve()) if self.settings_file else f"preset {self._preset}"

    def open_store(self, *, create: bool = False) -> Store:
        """Open the store."""
        from pipeline.store.store import Store

        return Store.open(self.store, create=create)

    def find_store(self) -> Store | None:
        """Open the store if there is one."""
        return self.open_store() if (self.store.expanduser().resolve() / "store.json").exists() else None

    @property
    def _preset(self) -> str:
        return _DEFAULT_PRESET if self.preset is None else self.preset

    def _record(self, study: str) -> StudyRecord:
        from pipeline.config.loading import preset_names
        from pipeline.workflow.record import recorded_study

        store = self.find_store()
        if study in preset_names() and (store is None or study not in store.studies()):
            raise PuddleError(f"no study is named {study}, but a preset is: --preset {study}")
        return recorded_study(store or self.open_store(), study)


@dataclass(frozen=True)
class StudyOptions(SettingsOptions):
    """The same options for a command whose subject is the study: its name stands alone, as in `puddle status NAME`."""

    study: OptionalStudy = None


@dataclass(frozen=True)
class ExecutionOptions:
    """Options that choose where work runs and which MLflow server mirrors it."""

    workers: Workers = None
    address: Annotated[
        str | None, typer.Option("--address", help="Run on this existing Ray cluster instead: host:port or auto.")
    ] = None
    tracking_uri: TrackingUri = None

    def __post_init__(self) -> None:
        """Refuse --workers together with --address, and limits that no study fits in."""
        if self.workers is not None and self.address is not None:
            got = f"--workers {self.workers} with --address {self.address}"
            raise PuddleError(f"--workers chooses cores of this machine: expected --workers or --address, got {got}")
        n_workers = number_of_cores() if self.workers is None else self.workers
        check_limits(0 if self.address else n_workers)

    def cluster(self) -> AbstractContextManager[Cluster]:
        """Start or join the cluster."""
        return serial_cluster() if self.workers == 0 else ray_cluster(self.address, self.workers)


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """Replace each dataclass parameter of a command by the options that are the dataclass's fields."""
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, Any] = {name: hint for name, hint in hints.items() if is_dataclass(hint)}
    options: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(command).parameters.items():
        if name in groups:
            of_field = get_type_hints(groups[name], include_extras=True)
            options += [
                inspect.Parameter(one.name, parameter.KEYWORD_ONLY, default=one.default, annotation=of_field[one.name])
                for one in fields(groups[name])
            ]
        else:
            options.append(parameter.replace(kind=parameter.KEYWORD_ONLY, annotation=hints[name]))

    @functools.wraps(command)
    def run(**values: Any) -> None:
        for name, group in groups.items():
            values[name] = group(**{one.name: values.pop(one.name) for one in fields(group)})
        command(**values)

    run.__signature__ = inspect.Signature(options)  # type: ignore[attr-defined]
    run.__annotations__ = {option.name: option.annotation for option in options}
    return run
