"""Structure: who may import whom, and science that touches no files, clocks or global generators."""

import ast
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]

FORBIDDEN_CALLS = re.compile(
    r"open|print|input|os\.(?!environ\b).*|(np|numpy|torch)\.(save.*|load.*|genfromtxt|fromfile|memmap)"
    r"|.*\.(tofile|read_text|write_text|read_bytes|write_bytes)|.*default_rng\(\)"
    r"|(np|numpy)\.random\.(?!Generator|SeedSequence|default_rng).*"
)


def test_the_contracts_of_imports_hold():
    script = "from importlinter.cli import lint_imports; raise SystemExit(lint_imports(no_cache=True))"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_task_is_arrays_in_arrays_out():
    for module in sorted((ROOT / "tasks").rglob("*.py")):
        nodes = list(ast.walk(ast.parse(module.read_text())))
        calls = [node for node in nodes if isinstance(node, ast.Call)]
        said = {ast.unparse(call.func) + end for call in calls for end in ("", "()" * (not call.args))}
        assert not [call for call in said if FORBIDDEN_CALLS.fullmatch(call)], module
