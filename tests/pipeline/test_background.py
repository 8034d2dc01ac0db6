"""Work beside the rest: in order, waited for at the end, and by nobody who was interrupted."""

import threading
import time

import pytest

from pipeline.background import SECONDS_OF_SILENCE, Background


def test_everything_is_done_in_order_before_the_end():
    done = []
    with Background("waiting", say=pytest.fail) as background:
        for number in range(100):
            background.do(lambda number=number: done.append((number, threading.get_ident())))
    numbers, threads = zip(*done, strict=True)
    assert numbers == tuple(range(100))
    assert len(set(threads)) == 1 and threads[0] != threading.get_ident()


def test_the_caller_goes_on_meanwhile():
    gone_on = threading.Event()
    with Background("waiting", say=pytest.fail) as background:
        background.do(lambda: gone_on.wait(60) or pytest.fail("the caller was kept waiting"))
        gone_on.set()


def test_a_long_wait_is_explained():
    said = []
    with Background("bringing it up to date", say=said.append) as background:
        background.do(lambda: time.sleep(SECONDS_OF_SILENCE + 0.5))
    assert said == ["bringing it up to date"]


def test_what_went_wrong_is_raised_at_the_end_and_the_rest_is_done():
    done = []
    with pytest.raises(ZeroDivisionError), Background("waiting", say=pytest.fail) as background:
        background.do(lambda: 1 / 0)
        background.do(lambda: done.append("the rest"))
    assert done == ["the rest"]


def test_an_error_of_the_callers_waits_and_is_the_one_that_is_raised():
    done = []
    with pytest.raises(KeyError), Background("waiting", say=pytest.fail) as background:
        background.do(lambda: time.sleep(0.2))
        background.do(lambda: done.append("all"))
        background.do(lambda: 1 / 0)
        raise KeyError
    assert done == ["all"]


def test_an_interruption_does_not_wait():
    never = threading.Event()
    with pytest.raises(KeyboardInterrupt), Background("waiting", say=pytest.fail) as background:
        background.do(never.wait)
        raise KeyboardInterrupt
    never.set()


def test_without_work_there_is_no_thread():
    before = threading.active_count()
    with Background("waiting", say=pytest.fail):
        assert threading.active_count() == before
