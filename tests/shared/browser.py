"""A real browser for tests: Chromium, driven through its debugging pipe."""

from __future__ import annotations

import base64
import fcntl
import io
import json
import os
import shutil
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-sync",
    "--disable-background-networking",
    "--disable-component-update",
    "--remote-debugging-pipe",
    "--hide-scrollbars",
)
PATIENCE = 30.0  # longest wait for an answer of the browser [s]


class Browser:
    """A headless Chromium with one tab, spoken to in DevTools JSON, ended by zero bytes, on descriptors 3 and 4."""

    def __init__(self, profile: Path) -> None:
        (read_theirs, write_ours), (read_ours, write_theirs) = os.pipe(), os.pipe()
        # Copies above 4, so that putting one at 3 cannot close the other.
        theirs = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (read_theirs, write_theirs)]
        silent = os.open(os.devnull, os.O_RDWR)
        self._pid = os.posix_spawn(
            CHROMIUM,
            [CHROMIUM, *FLAGS, f"--user-data-dir={profile}"],
            os.environ,
            file_actions=[
                *((os.POSIX_SPAWN_DUP2, end, place) for end, place in zip(theirs, (3, 4), strict=True)),
                *((os.POSIX_SPAWN_DUP2, silent, place) for place in (0, 1, 2)),
            ],
            setpgroup=0,
        )
        for end in (*theirs, read_theirs, write_theirs, silent):
            os.close(end)
        self._write, self._read, self._rest, self._sent = write_ours, read_ours, b"", 0
        os.set_blocking(self._read, False)
        self.events: list[dict[str, Any]] = []
        self._session: dict[str, str] = {}
        target = self("Target.createTarget", url="about:blank")["targetId"]
        self._session = {"sessionId": self("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]}
        for domain in ("Page", "Runtime", "Network", "Log"):
            self(f"{domain}.enable")

    def __call__(self, method: str, **params: Any) -> dict[str, Any]:
        self._sent += 1
        message = {"id": self._sent, "method": method, "params": params, **self._session}
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while (answer := self._next()).get("id") != self._sent:
            self.events.append(answer)
        assert "error" not in answer, (method, answer["error"])
        return answer["result"]

    def _next(self) -> dict[str, Any]:
        end = time.monotonic() + PATIENCE
        while b"\0" not in self._rest:
            assert time.monotonic() < end, "Chromium does not answer"
            try:
                self._rest += os.read(self._read, 1 << 20)
            except BlockingIOError:
                time.sleep(0.005)
        message, self._rest = self._rest.split(b"\0", 1)
        return json.loads(message)

    def open(self, page: Path, *, width: int) -> None:
        self.visit(page.as_uri(), width=width)

    def visit(self, address: str, *, width: int) -> None:
        self("Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1, mobile=width < 600)
        self.events.clear()
        self("Page.navigate", url=address)
        self.until("document.readyState === 'complete'")

    def evaluate(self, script: str) -> Any:
        answer = self("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def until(self, condition: str) -> None:
        end = time.monotonic() + PATIENCE
        while not self.evaluate(condition):
            assert time.monotonic() < end, f"never came true: {condition}"
            time.sleep(0.02)

    def named(self, method: str) -> list[dict[str, Any]]:
        self.evaluate("0")  # what happened before has then arrived
        return [event["params"] for event in self.events if event["method"] == method]

    def drawn(self, identity: str) -> np.ndarray:
        """Pixels that a script has drawn on a canvas, (height, width, 3).

        A screenshot may show what lies outside the window as it was before: a busy machine paints it later.
        """
        png = self.evaluate(f"document.getElementById('{identity}').toDataURL()").partition(",")[2]
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB"))

    def close(self) -> None:
        os.killpg(self._pid, signal.SIGKILL)  # its own group: it and the processes that it started
        os.waitpid(self._pid, 0)
        os.close(self._write)
        os.close(self._read)
