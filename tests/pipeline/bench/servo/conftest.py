"""A simulated Maestro: a real pty, and a thread that implements the controller's side of the protocol."""

import os
import pty
import select
import threading
import tty
from collections.abc import Iterator

import pytest

from tasks.bench.fabrication.calibration import Calibration, ServoCalibration

DATA_BYTES = {0x84: 3, 0x87: 3, 0x89: 3, 0x90: 1, 0xA1: 0}  # of each command in the user's guide
PROTOCOL_ERROR = 1 << 4


class FakeMaestro:
    """Implements the compact protocol, records every pulse, and misbehaves on demand."""

    def __init__(self, *, unplug_after: int | None = None) -> None:
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self.unplug_after = unplug_after
        self.answer = lambda honest: honest  # turns a correct answer into what is sent
        self.channel_range = (256, 10_000)  # the controller's own limits [quarter µs]
        self.errors = 0
        self.n_bytes = 0
        self.targets: list[tuple[int, float]] = []  # channel and pulse [µs], in order of arrival
        self.on: dict[int, float] = {}  # channel -> µs, while pulsing
        self.speeds: dict[int, int] = {}
        self._partial: list[int] = []
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while True:
            try:
                ready, _, _ = select.select([self._master], [], [], 0.02)
                if not ready:
                    if self._closing.is_set():
                        return
                    continue
                for byte in os.read(self._master, 4096):
                    if self.n_bytes == self.unplug_after:
                        os.close(self._master)
                        return
                    self.n_bytes += 1
                    self._take(byte)
            except OSError:
                return

    def _take(self, byte: int) -> None:
        if byte & 0x80:
            if self._partial or byte not in DATA_BYTES:
                self.errors |= PROTOCOL_ERROR
                self._partial = []
                if byte not in DATA_BYTES:
                    return
            self._partial = [byte]
        elif not self._partial:
            self.errors |= PROTOCOL_ERROR
            return
        else:
            self._partial.append(byte)
        if len(self._partial) == 1 + DATA_BYTES[self._partial[0]]:
            command, self._partial = self._partial, []
            self._obey(*command)

    def _obey(self, command: int, channel: int = 0, low: int = 0, high: int = 0) -> None:
        value = low + 128 * high
        if command == 0x84:
            self.targets.append((channel, value / 4))
            if value:
                self.on[channel] = min(max(value, self.channel_range[0]), self.channel_range[1]) / 4
            else:
                self.on.pop(channel, None)
        elif command == 0x87:
            self.speeds[channel] = value
        elif command == 0x90:
            self._say(round(4 * self.on.get(channel, 0.0)))
        elif command == 0xA1:
            errors, self.errors = self.errors, 0
            self._say(errors)

    def _say(self, value: int) -> None:
        os.write(self._master, self.answer(value.to_bytes(2, "little")))

    def finish(self) -> None:
        """Read what is left in the line, then stop the thread."""
        self._closing.set()
        self._thread.join(5.0)
        assert not self._thread.is_alive()

    def close(self) -> None:
        self.finish()
        os.close(self._slave)
        if self.unplug_after is None or self.n_bytes < self.unplug_after:
            os.close(self._master)

    def pulses(self, channel: int) -> list[float]:
        return [pulse for where, pulse in self.targets if where == channel]


@pytest.fixture
def plug() -> Iterator[type[FakeMaestro]]:
    """Start simulated controllers, and stop them after the test."""
    plugged = []

    def make(**execution) -> FakeMaestro:
        plugged.append(FakeMaestro(**execution))
        return plugged[-1]

    yield make
    for fake in plugged:
        fake.close()


@pytest.fixture(scope="session")
def calibration() -> Calibration:
    common = {"us_per_rad": 600.0, "min_us": 900.0, "max_us": 2100.0, "max_speed": 3.0}
    return Calibration(
        servos=(
            ServoCalibration(joint=2, channel=0, centre_us=1500.0, direction=1, **common),
            ServoCalibration(joint=4, channel=3, centre_us=1480.5, direction=-1, **common),
        )
    )
