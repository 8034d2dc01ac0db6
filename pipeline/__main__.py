"""The entry point: ``python -m pipeline`` is ``puddle``. It imports nothing slow before it can handle Ctrl-C."""

import os
import signal

_INTERRUPTED = 130  # as in pipeline/commands/exit_codes.py, which takes a second to import


def main() -> None:
    """Import the command line, and run it. Ctrl-C ends the import at once, without a traceback."""
    usual = signal.getsignal(signal.SIGINT)
    if usual is signal.default_int_handler:  # else the caller ignores the signal, as a shell does for a background job
        signal.signal(signal.SIGINT, lambda *_: os._exit(_INTERRUPTED))
    from pipeline.commands import app

    signal.signal(signal.SIGINT, usual)
    try:
        app.main()
    except KeyboardInterrupt:
        raise SystemExit(_INTERRUPTED) from None


if __name__ == "__main__":
    main()
