"""The probe of the preflight check: a process that tries to join an existing Ray cluster.

``python -P preflight_probe.py ADDRESS`` prints a line once Ray is imported (which may take longer than the cluster's
answer on a busy machine), joins the cluster, and exits. The exit code says whether the cluster admitted it, the last
line of standard error why not. Standard input is a pipe from the driver: when it closes, this process ends too.

It imports nothing from puddle and is started by its path, because the driver's import path need not be its own.
"""

import os
import sys
import threading


def main(address: str) -> None:
    """Join the cluster, or raise."""
    threading.Thread(target=_end_with_driver, daemon=True).start()
    import ray

    print("ready", flush=True)
    ray.init(address=address, log_to_driver=False, logging_level="ERROR")


def _end_with_driver() -> None:
    os.read(sys.stdin.fileno(), 1)  # returns when the pipe closes
    os._exit(1)


if __name__ == "__main__":
    main(sys.argv[1])
