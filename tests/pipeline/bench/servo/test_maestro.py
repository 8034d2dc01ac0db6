"""The Maestro protocol against the user's guide, and failing ports, on a pty with pyserial."""

import termios

import pytest

from pipeline.bench.servo import maestro
from pipeline.bench.servo.maestro import open_maestro
from pipeline.bench.servo.servo_controller import ControllerError, PortLostError
from pipeline.errors import PuddleError


def opened(fake, *, timeout=10.0):
    """Open a simulated controller; the long timeout lets a busy machine schedule its thread."""
    return open_maestro(fake.path, timeout=timeout)


def test_bytes_of_the_users_guide():
    assert maestro.set_target(0, 1500.0) == bytes.fromhex("84 00 70 2E")  # section 5.c
    assert maestro.set_target(5, 0.0) == bytes.fromhex("84 05 00 00")  # section 5.e: a target of 0 stops the pulses
    # Section 5.e: a speed of 140 is 3.5 µs a ms: from 1000 to 1350 µs in 100 ms. Its example is 87 05 0C 01.
    for rate in (3500.0, 3499.0):  # never below the host's limit
        assert maestro.set_limits(5, rate) == bytes.fromhex("87 05 0C 01 89 05 00 00")


def test_commands_reach_the_controller(plug):
    fake = plug()
    fake.errors = 1 << 5  # a time-out since the last run, which is no error of this one
    controller = opened(fake)
    controller.prepare({0: 1800.0, 3: 10.0})
    controller.send({0: 1500.0, 3: 1234.25})
    assert controller.position(3) == 1234.25 and controller.position(0) == 1500.0
    fake.errors = 1 << 1 | 1 << 4
    with pytest.raises(ControllerError, match=r"serial overrun.*serial protocol error"):
        controller.check()
    controller.check()
    controller.off((0, 3))
    assert controller.position(0) == 0.0
    controller.close()
    fake.finish()
    assert fake.speeds == {0: 72, 3: 1} and fake.errors == 0


@pytest.mark.parametrize(
    ("answer", "timeout", "said"),
    [
        (b"", 0.1, r"within 0\.1 s, got nothing"),
        (b"\x01", 2.0, "got 01"),
        (b"\xff\xff", 10.0, "expected error bits 0 to 8, got 0xffff"),
    ],
)
def test_invalid_answers(plug, answer, timeout, said):
    fake = plug()
    fake.answer = lambda honest: answer
    with pytest.raises(ControllerError, match=said):
        opened(fake, timeout=timeout).prepare({})


def test_a_port_that_is_gone_when_its_buffer_is_emptied(plug, monkeypatch):
    controller = opened(plug())

    def gone() -> None:
        raise termios.error(5, "Input/output error")

    monkeypatch.setattr(controller._port, "reset_input_buffer", gone)
    with pytest.raises(PortLostError, match="lost the port while sending"):
        controller.prepare({0: 100.0})


def test_unexpected_bytes_are_not_taken_for_an_answer(plug):
    fake = plug()
    controller = opened(fake)
    controller.prepare({})
    fake.answer = lambda honest: honest + b"PONG"
    controller.check()
    while not controller._port.in_waiting:
        pass
    with pytest.raises(ControllerError, match=r"expected no bytes.*50 4f 4e 47"):
        controller.check()


def test_ports_that_cannot_be_opened(plug, tmp_path):
    fake = plug()
    first = opened(fake)
    (tmp_path / "file").write_text("no port")
    for path, said in (("/dev/ttyNOPE", "no such port"), (fake.path, "busy"), (str(tmp_path / "file"), "serial port")):
        with pytest.raises(PuddleError, match=said):
            open_maestro(path, timeout=0.1)
    first.close()
