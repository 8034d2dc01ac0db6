"""The entry point: Ctrl-C while Python still imports what a command needs."""

import os
import signal
import subprocess
import sys
import tomllib
from functools import partial
from pathlib import Path

import pytest

from pipeline.commands.terminal import INTERRUPTED

ROOT = Path(__file__).parents[2]
SCRIPT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]["puddle"]
AS_MODULE = ("-m", "pipeline")
AS_SCRIPT = ("-c", "from {} import {} as main; main()".format(*SCRIPT.split(":")))  # as pip writes it
IMPORTS_FOREVER = "import time\nprint('importing', flush=True)\ntime.sleep(60)\n"


@pytest.mark.parametrize("arguments", [AS_MODULE, AS_SCRIPT], ids=["python -m pipeline", "puddle"])
def test_ctrl_c_during_the_imports_shows_no_traceback(arguments, tmp_path):
    (tmp_path / "typer.py").write_text(IMPORTS_FOREVER)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(tmp_path), str(ROOT)))}
    process = subprocess.Popen(
        [sys.executable, *arguments, "studies"],
        env=environment,
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # in the background it is ignored
    )
    with process:
        assert process.stdout.readline() == "importing\n"
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=30)
    assert (process.returncode, said) == (INTERRUPTED, ("", ""))
