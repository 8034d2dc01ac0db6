"""The command line as a person uses it, in this process."""

import pytest

from pipeline.commands.app import main


def call(*arguments: str) -> int:
    """Run `puddle` with arguments; return its exit code."""
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    return int(ended.value.code or 0)
