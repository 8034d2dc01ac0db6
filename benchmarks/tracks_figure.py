"""Draw docs/tracks-accuracy.png from docs/results/tracks-rollouts.json: `python -m benchmarks.tracks_figure`."""

import json
from collections.abc import Mapping, Sequence
from hashlib import sha256
from typing import Any

from matplotlib.figure import Figure

from benchmarks.published import PICTURES, RESULTS
from benchmarks.sentences import ROOT
from benchmarks.tracks_tables import share_of
from pipeline.report.drawing import FAINT, FIGURE_WIDTH, INK, Drawing, finish
from tasks.world import ENVIRONMENTS

PICTURE = "tracks-accuracy.png"
_COLOR = ENVIRONMENTS["residual_slush"].color
_FASTER = {"marker": "s", "markerfacecolor": "white"}  # than 60 frames a second
_BESIDE = 0.05  # of points of faster cameras, which would hide the others [mm]


def tracks_accuracy(results: Mapping[str, Any]) -> Drawing:
    """Draw how far robots get, as a share of exact states, over the noise of tracks and the number of throws.

    Args:
        results: of tracks-rollouts.json.
    """
    drawn = finish("tracks-accuracy", "What tracks are worth", lambda: _draw(results["studies"]))
    assert isinstance(drawn, Drawing)
    return drawn


def _draw(studies: Sequence[Mapping[str, Any]]) -> tuple[Figure, str]:
    (exact,) = (row for row in studies if row["learned_from"] == "exact states")
    tracked = [row for row in studies if row["learned_from"] == "tracks"]
    all_throws = max(row["n_throws"] for row in tracked)
    fewer_noise = {row["noise_mm"] for row in tracked if row["n_throws"] < all_throws}
    figure = Figure(figsize=(1.6 * FIGURE_WIDTH, 2.9), layout="constrained")
    by_noise, by_throws = figure.subplots(1, 2, sharey=True)
    for rate in sorted({row["rate"] for row in tracked}):
        rows = [row for row in tracked if row["rate"] == rate]
        of_noise = [row for row in rows if row["n_throws"] == all_throws]
        style = {"marker": "o"} if rate == 60 else {**_FASTER, "shift": _BESIDE}
        _points(by_noise, "noise_mm", of_noise, exact, label=f"{rate:g} frames/s", **style)
        if rate == 60:
            _points(by_throws, "n_throws", [row for row in rows if row["noise_mm"] in fewer_noise], exact, **style)
    for axes in (by_noise, by_throws):
        axes.axhline(100, color=INK, linewidth=0.8, linestyle=":")
        axes.grid(axis="y")
    by_noise.set(
        xlabel="noise of positions [mm]",
        ylabel="displacement,\nshare of exact states [%]",
        title=f"{all_throws} throws",
    )
    by_noise.legend(loc="lower left")
    by_throws.set(xlabel="number of throws", title=f"{', '.join(f'{of:g}' for of in fewer_noise)} mm of noise")
    by_throws.set_xlim(0, None)
    by_throws.set_ylim(0, None)
    return figure, "Displacement of robots that evolved in networks of tracked throws, with 95 % intervals."


def _points(
    axes: Any,
    name: str,
    rows: Sequence[Mapping[str, Any]],
    exact: Mapping[str, Any],
    *,
    shift: float = 0.0,
    **style: Any,
) -> None:
    """Draw the share of exact states of each row, with its 95 % interval."""
    ordered = sorted(rows, key=lambda row: row[name])
    shares = [share_of(row, exact) for row in ordered]
    values = [100 * share.value for share in shares]
    below = [100 * (share.value - share.low) for share in shares]
    above = [100 * (share.high - share.value) for share in shares]
    at = [row[name] + shift for row in ordered]
    axes.errorbar(at, values, yerr=(below, above), color=_COLOR, ecolor=FAINT, capsize=3, **style)


def main() -> None:
    """Draw the picture, and record its bytes."""
    results = json.loads((RESULTS / "tracks-rollouts.json").read_text(encoding="utf-8"))
    content = tracks_accuracy(results).png
    (ROOT / "docs" / PICTURE).write_bytes(content)
    index = ROOT / "docs" / PICTURES
    document = json.loads(index.read_text(encoding="utf-8"))
    note = "drawn by benchmarks/tracks_figure.py from tracks-rollouts.json, as a test compares"
    document["pictures"][PICTURE] = {"results": None, "note": note, "sha256": sha256(content).hexdigest()}
    index.write_text(f"{json.dumps(document, indent=1)}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
