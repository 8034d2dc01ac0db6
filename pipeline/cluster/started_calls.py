"""Which calls have begun: workers leave marks in the key-value store of Ray's head, and the driver looks there.

Ray tells a driver that a call has ended, not whether it works or waits behind those of another driver. Its list of
tasks would say so, at a cost, and needs a dashboard. The mark of a call whose worker was killed stays, 50 bytes, as
long as the head runs; so one that is run again after that has begun already.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator


@contextlib.contextmanager
def marked(mark: bytes | None) -> Iterator[None]:
    """Leave a mark, on a worker, while a call runs; None leaves none."""
    if mark is None:
        yield
        return
    from ray.experimental.internal_kv import _internal_kv_del, _internal_kv_put

    _internal_kv_put(mark, b"")
    try:
        yield
    finally:
        _internal_kv_del(mark)


def marks(prefix: bytes) -> list[bytes]:
    """List the marks that begin so."""
    from ray.experimental.internal_kv import _internal_kv_list

    found: list[bytes] = _internal_kv_list(prefix)
    return found
