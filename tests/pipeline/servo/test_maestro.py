"""The protocol against the bytes of the user's guide, and ports that fail, on a real pty with a real pyserial."""

import os
import pty

import pytest

from pipeline.errors import PuddleError
from pipeline.servo import maestro
from pipeline.servo.controller import ControllerFault, PortLost
from pipeline.servo.maestro import open_maestro


def opened(fake, **execution):
    return open_maestro(fake.path, baud=115200, baud_detection=False, **execution)


def test_bytes_of_the_users_guide():
    assert maestro.set_target(0, 1500.0) == bytes.fromhex("84 00 70 2E")  # section 5.c
    assert maestro.set_target(5, 0.0) == bytes.fromhex("84 05 00 00")  # section 5.e: a target of 0 stops the pulses
    # Section 5.e: a speed of 140 is 3.5 µs a ms: from 1000 to 1350 µs in 100 ms. Its example is 87 05 0C 01.
    assert maestro.set_speed(5, 3500.0) == bytes.fromhex("87 05 0C 01")
    assert maestro.set_speed(5, 3499.0) == bytes.fromhex("87 05 0C 01")  # never below what the host may ask
    assert maestro.no_acceleration_limit(5) == bytes.fromhex("89 05 00 00")
    with pytest.raises(ValueError, match="two data bytes"):
        maestro.set_target(0, 5000.0)


def test_a_session(plug):
    fake = plug()
    driver = opened(fake)
    driver.prepare({0: 1800.0, 3: 10.0})
    driver.send({0: 1500.0, 3: 1234.25})
    assert driver.position(3) == 1234.25 and driver.position(0) == 1500.0
    driver.check()
    driver.off((0, 3))
    assert driver.position(0) == 0.0
    driver.home()
    driver.close()
    fake.finish()
    assert fake.speeds == {0: 72, 3: 1}
    assert fake.commands[-1] == (0xA2,)
    assert fake.errors == 0 and not fake.baud_indications


def test_the_baud_rate_is_told_where_the_controller_wants_to_hear_it(plug):
    fake = plug()
    driver = open_maestro(fake.path, baud=9600, baud_detection=True)
    driver.prepare({})
    assert fake.baud_indications == 1 and fake.commands[0] == (0xA1,)


def test_old_errors_are_forgotten_and_new_ones_told(plug):
    fake = plug()
    fake.errors = 1 << 5
    driver = opened(fake)
    driver.prepare({0: 1000.0})
    fake.errors = 1 << 1 | 1 << 4
    with pytest.raises(ControllerFault, match=r"serial overrun.*serial protocol error"):
        driver.check()
    driver.check()


@pytest.mark.parametrize(("answer", "said"), [(b"", "nothing"), (b"\x01", "came 01"), (b"\xff\xff", "mean nothing")])
def test_answers_that_are_none(plug, answer, said):
    fake = plug()
    fake.answer = lambda honest: answer
    with pytest.raises(ControllerFault, match=said):
        opened(fake).prepare({})


def test_chatter_is_no_answer(plug):
    fake = plug()
    driver = opened(fake)
    driver.prepare({})
    fake.answer = lambda honest: honest + b"PONG"
    driver.check()
    while not driver._port.in_waiting:
        pass
    with pytest.raises(ControllerFault, match=r"expected silence.*50 4f 4e 47"):
        driver.check()


def test_a_port_that_is_missing_busy_or_none(plug, tmp_path):
    with pytest.raises(PuddleError, match="no such port"):
        open_maestro("/dev/ttyNOPE", baud=9600, baud_detection=False)
    fake = plug()
    first = opened(fake)
    with pytest.raises(PuddleError, match="busy"):
        opened(fake)
    first.close()
    (tmp_path / "file").write_text("no port")
    with pytest.raises(PuddleError, match="serial port"):
        open_maestro(str(tmp_path / "file"), baud=9600, baud_detection=False)


def test_a_port_that_is_unplugged():
    master, slave = pty.openpty()
    driver = open_maestro(os.ttyname(slave), baud=9600, baud_detection=False)
    os.close(master)
    with pytest.raises(PortLost, match="lost while sending"):
        driver.send({0: 1500.0})
    with pytest.raises(PortLost, match="lost while asking"):
        driver.check()
    driver.close()
    os.close(slave)
