"""The hello: a process that tries to join an existing Ray cluster, for a driver that can't wait two minutes for a no.

``python -P hello.py ADDRESS``: it says a line on standard output once Ray is imported, which takes longer on a slow
disk or a busy machine than a cluster may take to answer; then it joins, and ends. Its exit code says whether it was let
in, its last line on standard error why not. Standard input is a pipe from the driver: when that closes, because the
driver gave up or was killed, this process ends.

It imports nothing of puddle, and is started by its path: the driver's way of finding puddle need not be its own.
"""

from __future__ import annotations

import os
import sys
import threading


def main(address: str) -> None:
    """Join, or raise."""
    threading.Thread(target=_end_with_driver, daemon=True).start()
    import ray

    print("ready", flush=True)
    ray.init(address=address, log_to_driver=False, logging_level="ERROR")


def _end_with_driver() -> None:
    """Wait for the end of the pipe."""
    os.read(sys.stdin.fileno(), 1)
    os._exit(1)


if __name__ == "__main__":
    main(sys.argv[1])
