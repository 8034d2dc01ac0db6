"""Background work: in order, and awaited at the end unless the block fails."""

import threading

import pytest

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
def test_a_block_that_fails_does_not_wait(error):
    never = threading.Event()
    with pytest.raises(error), Background("waiting", say=pytest.fail) as background:
        background.do(never.wait)
        raise error
    never.set()
