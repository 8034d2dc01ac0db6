"""The options that commands share, declared once."""

from __future__ import annotations

import functools
import inspect
import os
import shlex
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from pipeline.cluster import Cluster, ray_cluster, serial_cluster
from pipeline.errors import PuddleError

if TYPE_CHECKING:
    from pipeline.config.settings import Settings
    from pipeline.store.store import Store

_DEFAULT_PRESET = "laptop"
_STORE_VARIABLE = "PUDDLE_STORE"
DEFAULT_STORE = Path("store")

StorePath = Annotated[Path, typer.Option("--store", envvar=_STORE_VARIABLE, help="The folder that holds results.")]
Workers = Annotated[
    int | None, typer.Option("--workers", min=0, help="Cores of this machine to use; default all, 0 runs without Ray.")
]
TrackingUri = Annotated[
    str | None,
    typer.Option("--tracking-uri", envvar="MLFLOW_TRACKING_URI", help="An MLflow server; default a file in the store."),
]


@dataclass(frozen=True)
class StudyOptions:
    """Options that choose a study: its settings, and the store that holds its results."""

    preset: Annotated[
        str, typer.Option("--preset", help="A file in configs/: smoke, laptop, row, paper or pontoon.")
    ] = _DEFAULT_PRESET
    settings_file: Annotated[Path | None, typer.Option("--settings", help="A settings file, not a preset.")] = None
    overrides: Annotated[
        list[str] | None, typer.Option("--set", help="Change one setting, for example evolution.n_generations=50.")
    ] = None
    store: StorePath = DEFAULT_STORE

    def settings(self) -> Settings:
        """Load the settings."""
        from pipeline.config.loading import load, preset_path
        from pipeline.config.settings import Settings

        return load(Settings, self.settings_file or preset_path(self.preset), self.overrides or ())

    def open_store(self, *, create: bool) -> Store:
        """Open the store."""
        from pipeline.store.store import Store

        return Store.open(self.store, create=create)

    def command(self, name: str) -> str:
        """Return the command line that runs another command with the same options."""
        words = ["puddle", name]
        if self.settings_file is not None:
            words += ["--settings", str(self.settings_file)]
        elif self.preset != _DEFAULT_PRESET:
            words += ["--preset", self.preset]
        for override in self.overrides or ():
            words += ["--set", override]
        if self.store != Path(os.environ.get(_STORE_VARIABLE) or DEFAULT_STORE):
            words += ["--store", str(self.store)]
        return shlex.join(words)


@dataclass(frozen=True)
class ExecutionOptions:
    """Options that choose where work runs and which MLflow server mirrors it."""

    workers: Workers = None
    address: Annotated[
        str | None, typer.Option("--address", envvar="RAY_ADDRESS", help="Run on this existing Ray cluster instead.")
    ] = None
    tracking_uri: TrackingUri = None

    def check(self, context: typer.Context) -> None:
        """Refuse --workers together with --address; an address in the environment is only a default."""
        source = context.get_parameter_source("address")
        explicit = source is not None and source.name == "COMMANDLINE"
        if self.workers is not None and self.address not in (None, "local") and explicit:
            got = f"--workers {self.workers} with --address {self.address}"
            raise PuddleError(f"--workers chooses cores of this machine: expected --workers or --address, got {got}")

    def cluster(
        self, on_ray: Callable[..., AbstractContextManager[Cluster]] = ray_cluster
    ) -> Callable[[], AbstractContextManager[Cluster]]:
        """Return the function that starts or joins the cluster. --workers overrides an address in the environment."""
        if self.workers == 0:
            return serial_cluster
        return lambda: on_ray(address=self.address if self.workers is None else "local", n_workers=self.workers)


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
