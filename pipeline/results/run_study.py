"""A study run from Python: `puddle study` in a process of its own, so that no stop or crash takes a notebook along."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic_core import to_json

from pipeline.config.loading import load, preset_path
from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.results.recorded_study import Study, open_study

_INCOMPLETE = 1  # exit code of a study of which some work failed, as in pipeline/commands/terminal.py
_PROGRAM = f"""
import os, signal, sys, threading
sys.path.insert(0, {str(Path(__file__).parents[2])!r})
import pipeline.__main__, tasks
del sys.path[0]
threading.Thread(target=lambda: os.read(0, 1) or os.kill(os.getpid(), signal.SIGTERM), daemon=True).start()
pipeline.__main__.main()
"""  # it stops when its standard input closes: when the caller wants it to, and when the caller dies


def run_study(
    preset: str | Path = "laptop", *, store: str | Path = "store", workers: int | None = None, **settings: Any
) -> Study:
    """Run a study as `puddle study` does, in a process of its own; show its progress, and return it.

    Interrupt the call to stop it; the same call resumes it. Where work items fail, the rest is done all the same, and
    ``study.progress`` counts them.

    >>> study = puddle.run_study("smoke", name="deep", grid={"depths": [9.0]}, evolution={"n_generations": 20})

    Args:
        preset: name of a preset, or a settings file (.yaml).
        store: folder of the results; it is made if there is none.
        workers: cores of this machine to use, by default all; 0 runs without Ray.
        settings: what differs from the preset; of a group a dictionary of what differs.

    Raises:
        PuddleError: a setting is wrong, or the study can't be run.
    """
    option, file = ("--settings", Path(preset)) if Path(preset).suffix else ("--preset", preset_path(str(preset)))
    overrides = list(_overrides(settings))
    name = load(Settings, file, overrides).name
    command = [sys.executable, "-P", "-c", _PROGRAM, "study", option, str(preset), "--store", str(store)]
    command += [] if workers is None else ["--workers", str(workers)]
    command += [word for override in overrides for word in ("--set", override)]
    child = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "TTY_COMPATIBLE": "0"},  # lines, not bars: a notebook sets FORCE_COLOR
        start_new_session=True,  # Ctrl-C is the caller's
    )
    error = ""
    with child:
        assert child.stdin is not None and child.stderr is not None
        try:
            for line in child.stderr:
                if error or line.startswith("puddle: "):
                    error += line.removeprefix("puddle: ")
                else:
                    sys.stderr.write(line)
        except KeyboardInterrupt:
            child.stdin.close()
            child.wait()
            raise KeyboardInterrupt("Stopped. Finished work is safe: the same call resumes from there.") from None
    if child.returncode not in (0, _INCOMPLETE):
        ended = f"study {name}: its process ended with exit code {child.returncode}; the same call resumes it"
        raise PuddleError(error.strip() or ended)
    return open_study(name, store)


def _overrides(settings: Mapping[str, Any], group: str = "") -> Iterator[str]:
    """Yield assignments as ``--set`` takes them."""
    for name, value in settings.items():
        stated = value.model_dump(exclude_unset=True) if isinstance(value, BaseModel) else value
        if isinstance(stated, Mapping) and stated:
            yield from _overrides(stated, f"{group}{name}.")
        else:
            yield f"{group}{name}={to_json(stated, fallback=_plain).decode()}"


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else str(value)  # an array, or a number of NumPy
