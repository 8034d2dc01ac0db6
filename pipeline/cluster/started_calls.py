"""Which calls workers have started, recorded in the key-value store of Ray's head.

Ray reports that a call has ended, but not whether it runs or waits behind another driver's calls; its task list would,
but it is expensive and needs the dashboard. The entry of a call whose worker was killed stays (50 bytes) until the head
ends, so a call that Ray retries counts as started at once.
"""

import contextlib
from collections.abc import Iterator


@contextlib.contextmanager
def recorded_as_started(key: bytes | None) -> Iterator[None]:
    """Record, on a worker, that a call runs; None records nothing."""
    if key is None:
        yield
        return
    from ray.experimental.internal_kv import _internal_kv_del, _internal_kv_put

    _internal_kv_put(key, b"")
    try:
        yield
    finally:
        _internal_kv_del(key)


def started_keys(prefix: bytes) -> list[bytes]:
    """List the recorded keys that begin with a prefix."""
    from ray.experimental.internal_kv import _internal_kv_list

    found: list[bytes] = _internal_kv_list(prefix)
    return found
