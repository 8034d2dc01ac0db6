"""Draw pictures of docs anew from results files, without a store: `python -m benchmarks.study_figures`.

It draws those of docs/results/pictures.json that show champions alone, as the paper's Fig. 4 does, in ten seconds.
"""

import json
from collections.abc import Callable, Mapping
from functools import partial
from hashlib import sha256
from typing import Any

from matplotlib.figure import Figure

from benchmarks.published import PICTURES, RESULTS
from pipeline.report.champion_figures import transfer_across_depths, transfer_at_depth
from pipeline.report.data import StudyReport, TrialResult
from pipeline.report.drawing import Missing, finish

_DOCS = RESULTS.parent
_DRAW: Mapping[str, Callable[[StudyReport], tuple[Figure, str]]] = {
    "transfer_at_depth": transfer_at_depth,
    "transfer_across_depths": transfer_across_depths,
}


def report_of(results: Mapping[str, Any]) -> StudyReport:
    """Return what a results file says of a study's champions, as the figures of its page read it."""
    names = ("environment", "depth", "trial", "predicted", "predicted_sd", "fitness", "zero_shot", "adapted")
    trials = [TrialResult(**{name: champion.get(name) for name in names}) for champion in results["champions"]]
    return StudyReport(results["study"], results["study"], {}, "", trials=trials)


def pictures() -> dict[str, bytes]:
    """Draw the pictures, by their names in docs, as PNG."""
    found = {}
    for name, picture in json.loads((_DOCS / PICTURES).read_text(encoding="utf-8"))["pictures"].items():
        if (figure := picture.get("figure")) in _DRAW:
            results = json.loads((RESULTS / f"{picture['results']}.json").read_text(encoding="utf-8"))
            drawing = finish(figure, figure, partial(_DRAW[figure], report_of(results)))
            if isinstance(drawing, Missing):
                raise RuntimeError(f"{name} can't be drawn from {picture['results']}.json: {drawing.reason}")
            found[name] = drawing.png
    return found


def main() -> None:
    """Write the pictures, and note their digests."""
    document = json.loads((_DOCS / PICTURES).read_text(encoding="utf-8"))
    for name, png in pictures().items():
        (_DOCS / name).write_bytes(png)
        document["pictures"][name]["sha256"] = sha256(png).hexdigest()
    (_DOCS / PICTURES).write_text(f"{json.dumps(document, indent=1)}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
