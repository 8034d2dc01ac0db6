"""The files of the repository, as the architecture tests read them."""

import ast
import subprocess
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]


@cache
def tracked_files(*patterns: str) -> list[str]:
    """List the files of the repository that exist and match, in order; new files count before they are committed."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *patterns]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    return sorted({name for name in listed if (ROOT / name).is_file()})


@cache
def syntax(name: str) -> ast.Module:
    """Parse a Python file."""
    return ast.parse((ROOT / name).read_text())


SOURCES = tracked_files("pipeline/*.py", "tasks/*.py", "puddle/*.py")
"""Every module of the packages."""
