"""Background work: in order, and awaited at the end unless the block fails."""

import threading
import time

import pytest

from pipeline.workflow import background as background_module
from pipeline.workflow.background import Background


def test_everything_is_done_in_order_before_the_end_while_the_caller_continues():
    done, gone_on = [], threading.Event()
    with Background("waiting", say=pytest.fail) as background:
        background.do(lambda: gone_on.wait(60) or pytest.fail("the caller was kept waiting"))
        for number in range(100):
            background.do(lambda number=number: done.append(number))
        gone_on.set()
    assert done == list(range(100))


@pytest.mark.parametrize("error", [ArithmeticError, SystemExit])
def test_an_error_is_raised_at_the_end_and_the_rest_is_done(error):
    def go_wrong():
        raise error

    done = []
    with pytest.raises(error), Background("waiting", say=pytest.fail) as background:
        background.do(go_wrong)
        background.do(lambda: done.append("the rest"))
    assert done == ["the rest"]


@pytest.mark.parametrize("error", [KeyError, KeyboardInterrupt])
def test_a_block_that_fails_waits_for_its_last_call_alone(error):
    begun, done = threading.Event(), []
    with pytest.raises(error), Background("waiting", say=pytest.fail) as background:
        background.do_last(lambda: done.append("without a thread"))
        background.do(lambda: begun.set() or time.sleep(0.1))
        begun.wait()
        background.do(lambda: done.append("waiting"))
        background.do_last(lambda: done.append("last"))
        raise error
    assert done == ["last"]


def test_the_wait_for_the_last_call_is_short(monkeypatch):
    monkeypatch.setattr(background_module, "SECONDS_AFTER_AN_ERROR", 0.2)
    never, begin = threading.Event(), time.monotonic()
    with pytest.raises(KeyError), Background("waiting", say=pytest.fail) as background:
        background.do(never.wait)
        background.do_last(lambda: None)
        raise KeyError
    assert time.monotonic() - begin < 2
    never.set()
