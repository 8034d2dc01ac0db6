"""The entry point: ``python -m pipeline`` is ``puddle``. It imports nothing slow before it can handle Ctrl-C."""

import gc
import os
import signal

_INTERRUPTED = 130  # as in pipeline/commands/terminal.py, which takes a second to import
_OBJECTS_PER_COLLECTION = 20_000  # at Python's 700, a quarter of a start-up goes to collections, which find no garbage


def main() -> None:
    """Import the command line, and run it. Ctrl-C ends the import at once, without a traceback."""
    usual = signal.getsignal(signal.SIGINT)
    if usual is signal.default_int_handler:  # else the caller ignores the signal, as a shell does for a background job
        signal.signal(signal.SIGINT, lambda *_: os._exit(_INTERRUPTED))
    gc.set_threshold(_OBJECTS_PER_COLLECTION)
    from pipeline.commands import app

    signal.signal(signal.SIGINT, usual)
    try:
        app.main()
    except KeyboardInterrupt:
        raise SystemExit(_INTERRUPTED) from None


if __name__ == "__main__":
    main()
