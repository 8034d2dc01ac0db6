"""The options that commands share, declared once."""

from __future__ import annotations

import functools
import inspect
import json
import os
import shlex
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from pipeline.cluster import Cluster, ray_cluster, serial_cluster
from pipeline.commands.output import to_stdout
from pipeline.errors import PuddleError

if TYPE_CHECKING:
    from pipeline.config.settings import Settings
    from pipeline.store.store import Store, StudyRecord

_DEFAULT_PRESET = "laptop"
_STORE_VARIABLE = "PUDDLE_STORE"
DEFAULT_STORE = Path("store")


def names_of_studies(context: typer.Context, incomplete: str) -> list[str]:
    """Complete the name of a study of the store."""
    folder = Path(context.params.get("store") or os.environ.get(_STORE_VARIABLE) or DEFAULT_STORE).expanduser()
    names = (path.parent.name for path in (folder / "studies").glob("*/study.json"))
    return sorted(name for name in names if name.startswith(incomplete))


def _names_of_presets(incomplete: str) -> list[str]:
    """Complete the name of a preset."""
    from pipeline.config.loading import preset_names

    return [name for name in preset_names() if name.startswith(incomplete)]


StorePath = Annotated[Path, typer.Option("--store", envvar=_STORE_VARIABLE, help="The folder that holds results.")]
Workers = Annotated[
    int | None, typer.Option("--workers", min=0, help="Cores of this machine to use; default all, 0 runs without Ray.")
]
TrackingUri = Annotated[
    str | None,
    typer.Option("--tracking-uri", envvar="MLFLOW_TRACKING_URI", help="An MLflow server; default a file in the store."),
]
StudyName = Annotated[
    str | None,
    typer.Option(
        "--study", metavar="NAME", autocompletion=names_of_studies, help="A study of the store: its recorded settings."
    ),
]
StudyArgument = Annotated[
    str, typer.Argument(metavar="NAME", autocompletion=names_of_studies, help="A study of the store.")
]
SimulatedIn = Annotated[
    str, typer.Option("--environment", help="The environment, such as true_slush; a wrong name lists them all.")
]
GroundDepth = Annotated[float, typer.Option("--depth", help="Depth of the ground below the surface [m].")]
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
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document, for programs.")]


def print_json(document: Any) -> None:
    """Print a JSON document on standard output."""
    to_stdout(json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False))


@dataclass(frozen=True)
class StudyOptions:
    """Options that choose a study: its settings, and the store that holds its results."""

    study: StudyName = None
    preset: Annotated[
        str | None,
        typer.Option(
            "--preset",
            autocompletion=_names_of_presets,
            help="Settings in configs/, such as smoke; laptop by default. A wrong name lists them all.",
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
    store: StorePath = DEFAULT_STORE

    def __post_init__(self) -> None:
        """Refuse more than one source of settings."""
        if len(given := self._given()) > 1:
            got = " with ".join(shlex.join(words) for words in given)
            raise PuddleError(f"expected only one of --study, --preset and --settings, got {got}")

    def settings(self) -> Settings:
        """Load the settings: those on record for a study that is named, else those of a file or a preset.

        Tracks that they name are read, so that the settings know their digests.
        """
        from pipeline.stages.tracked import with_tracks

        return with_tracks(self._loaded(), self.tracks)

    def _loaded(self) -> Settings:
        from pipeline.config.loading import load, parse, preset_path
        from pipeline.config.settings import Settings
        from pipeline.workflow.record import settings_of

        overrides = list(self.overrides or ())
        if self.tracks and any(override.startswith("tracks.") for override in overrides):
            # Settings of tracks are valid only beside the file.
            overrides = ["throws.source=tracks", f"tracks.file={json.dumps(str(self.tracks))}", *overrides]
        if self.study is None:
            path = self.settings_file or preset_path(_DEFAULT_PRESET if self.preset is None else self.preset)
            return load(Settings, path, overrides)
        recorded = settings_of(self._record(self.study))
        if not overrides:
            return recorded
        name = f"the settings of study {self.study}"
        return parse(Settings, recorded.model_dump_json(), name=name, overrides=overrides)

    @property
    def source(self) -> str:
        """Where the settings come from, for the study's record: "preset laptop", or the path of a settings file."""
        if self.study is not None:
            return self._record(self.study).source
        return (
            str(self.settings_file.resolve())
            if self.settings_file
            else f"preset {_DEFAULT_PRESET if self.preset is None else self.preset}"
        )

    def open_store(self, *, create: bool) -> Store:
        """Open the store."""
        from pipeline.store.store import Store

        return Store.open(self.store, create=create)

    def find_store(self) -> Store | None:
        """Open the store if there is one."""
        from pipeline.store import disk

        root = disk.resolved(self.store)
        with disk.explained("looking for a store", root):
            exists = (root / "store.json").exists()
        return self.open_store(create=False) if exists else None

    def command(self, name: str) -> str:
        """Return the command line that runs another command with the same options."""
        words = ["puddle", name]
        for given in self._given():
            words += given if given != ["--preset", _DEFAULT_PRESET] else []
        for override in self.overrides or ():
            words += ["--set", override]
        words += ["--tracks", str(self.tracks)] if self.tracks else []
        if self.store != Path(os.environ.get(_STORE_VARIABLE) or DEFAULT_STORE):
            words += ["--store", str(self.store)]
        return shlex.join(words)

    def named(self, study: str) -> StudyOptions:
        """Return the options that choose a study of the same store by its name."""
        return StudyOptions(study=study, store=self.store)

    def _record(self, study: str) -> StudyRecord:
        from pipeline.workflow.record import recorded_study

        return recorded_study(self.open_store(create=False), study)

    def _given(self) -> list[list[str]]:
        """Return the options given that name a source of settings, each with its value."""
        options = {"--study": self.study, "--preset": self.preset, "--settings": self.settings_file}
        return [[option, str(value)] for option, value in options.items() if value is not None]


@dataclass(frozen=True)
class ExecutionOptions:
    """Options that choose where work runs and which MLflow server mirrors it."""

    workers: Workers = None
    address: Annotated[
        str | None, typer.Option("--address", help="Run on this existing Ray cluster instead: host:port or auto.")
    ] = None
    tracking_uri: TrackingUri = None

    def __post_init__(self) -> None:
        """Refuse --workers together with --address."""
        if self.workers is not None and self.address is not None:
            got = f"--workers {self.workers} with --address {self.address}"
            raise PuddleError(f"--workers chooses cores of this machine: expected --workers or --address, got {got}")

    def cluster(
        self, on_ray: Callable[..., AbstractContextManager[Cluster]] = ray_cluster
    ) -> Callable[[], AbstractContextManager[Cluster]]:
        """Return the function that starts or joins the cluster."""
        return serial_cluster if self.workers == 0 else lambda: on_ray(address=self.address, n_workers=self.workers)


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
