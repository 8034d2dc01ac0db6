"""The notebook and the tutorial of docs/: their Python runs on a study, and the notebook's outputs show no fault."""

import json
import math
import re
from pathlib import Path

import matplotlib as mpl
import pytest

ROOT = Path(__file__).parents[3]
NOTEBOOK = ROOT / "docs" / "analysis.ipynb"
OPENED = re.compile(r'puddle\.open_study\("nine-metres", store="\.\./store"\)')


@pytest.fixture(scope="module")
def notebook():
    return json.loads(NOTEBOOK.read_text())


def sources(notebook) -> list[str]:
    return ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]


def test_its_cells_run_on_a_study(notebook, recorded, capsys):
    code = sources(notebook)
    code[0], n_changed = OPENED.subn(lambda _: f"puddle.open_study('tiny', store={str(recorded)!r})", code[0])
    assert n_changed == 1
    names: dict[str, object] = {}
    with mpl.rc_context({"backend": "agg"}):
        for number, cell in enumerate(code):
            exec(compile(cell, f"cell {number} of {NOTEBOOK.name}", "exec"), names)
    assert "128 designs in 8 trials" in capsys.readouterr().out
    assert names["again"] == names["best"]["zero_shot"]
    assert set(names["tests"]["environment"]) <= {"true_slush", "dry_land", "residual_slush", "single_member"}
    figure = names["figure"]
    assert len(figure.axes) == 4 and all(axis.lines for axis in figure.axes)


def test_the_python_of_the_tutorial_runs(recorded, capsys):
    (code,) = re.findall(r"^```python\n(.*?)^```$", (ROOT / "docs" / "tutorial.md").read_text(), flags=re.M | re.S)
    code = code.replace('"smoke", store="store"', f'"tiny", store={str(recorded)!r}').replace("depth=9.0", "depth=1.0")
    names: dict[str, object] = {}
    exec(compile(code, "tutorial.md", "exec"), names)
    assert "true_slush" in (printed := capsys.readouterr().out) and len(names["champion"]) == 1
    assert math.isfinite(float(printed.splitlines()[-1].strip("[]")))
