"""The options that commands share, and what is chosen by them."""

from __future__ import annotations

import os
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from pipeline.config.settings import Settings
    from pipeline.store.store import Store

Preset = Annotated[str, typer.Option("--preset", help="Settings in configs/: smoke, laptop, row, paper, pontoon.")]
SettingsFile = Annotated[Path | None, typer.Option("--settings", help="A settings file instead of a preset.")]
Overrides = Annotated[list[str] | None, typer.Option("--set", help="Change one setting: evolution.n_generations=50.")]
STORE_VARIABLE = "PUDDLE_STORE"
StorePath = Annotated[Path, typer.Option("--store", envvar=STORE_VARIABLE, help="Where results are kept.")]
Workers = Annotated[
    int | None, typer.Option("--workers", min=0, help="Cores to use here; all by default, 0 for none but this process.")
]
Address = Annotated[
    str | None, typer.Option("--address", envvar="RAY_ADDRESS", help="An existing Ray cluster, to run on instead.")
]
TrackingUri = Annotated[
    str | None,
    typer.Option("--tracking-uri", envvar="MLFLOW_TRACKING_URI", help="An MLflow server; the store's own by default."),
]

DEFAULT_PRESET, DEFAULT_STORE = "laptop", Path("store")


@dataclass(frozen=True)
class Chosen:
    """What the options that all commands share say."""

    preset: str
    settings_file: Path | None
    overrides: tuple[str, ...]
    store: Path

    def settings(self) -> Settings:
        """Read the settings."""
        from pipeline.config.loading import load, preset_path
        from pipeline.config.settings import Settings

        return load(Settings, self.settings_file or preset_path(self.preset), self.overrides)

    def open_store(self, *, create: bool) -> Store:
        """Open the store."""
        from pipeline.store.store import Store

        return Store.open(self.store, create=create)

    def command(self, name: str) -> str:
        """Give the command line that runs another command under the same options."""
        words = ["puddle", name]
        if self.settings_file is not None:
            words += ["--settings", str(self.settings_file)]
        elif self.preset != DEFAULT_PRESET:
            words += ["--preset", self.preset]
        for override in self.overrides:
            words += ["--set", override]
        if self.store != Path(os.environ.get(STORE_VARIABLE) or DEFAULT_STORE):  # what the command takes by itself
            words += ["--store", str(self.store)]
        return shlex.join(words)
