"""What `puddle study` shows when it is done: the headline figures, where the page is, and what to do next."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from pipeline.config.settings import Settings
from pipeline.stages import segments
from pipeline.stages.report import PAGE
from pipeline.stages.transfer import read_scores
from pipeline.store.store import Store
from pipeline.workflow.stage import Upstream
from tasks.world import ENVIRONMENTS


def headline_lines(
    settings: Settings, upstream: Upstream, store: Store, *, how_to_run: Callable[[str], str]
) -> Iterator[str]:
    """Yield the champions' displacement at the greatest depth, the page's address, and the commands to try next.

    Args:
        settings: the study's settings.
        upstream: results of all stages.
        store: where they are.
        how_to_run: returns the command line that runs a command on this study.
    """
    yield ""
    yield from _figures(settings, upstream, store)
    page = store.export_path(settings.name) / PAGE
    if page.is_file():
        yield f"Open: {page.as_uri()}"
    yield "Next:"
    by_name = f" --study {settings.name}"
    commands = {
        how_to_run("champions"): "rank the champions",
        f"{how_to_run('export')} --out {settings.name}".replace(by_name, f" {settings.name}"): "take the results out",
        how_to_run("ui").replace(by_name, ""): "browse runs and curves in MLflow",
    }
    width = max(map(len, commands))
    yield from (f"  {command:<{width}}  {what}" for command, what in commands.items())


def _figures(settings: Settings, upstream: Upstream, store: Store) -> Iterator[str]:
    depth = max(settings.grid.depths)
    scores = [score for score in read_scores(settings, upstream["transfer"], store) if score["depth"] == depth]
    of_true_slush = [score for score in scores if score["environment"] == "true_slush"]
    best = {
        "share of True Slush": _mean([score.get("zero_shot") for score in of_true_slush]),
        "share of it adapted": _mean([score.get("adapted") for score in of_true_slush]),
    }
    yield f"Champions of study {settings.name} in True Slush, {depth:g} m deep: mean ± SD over trials [m]"
    yield f"selected for: {settings.selected_for}"
    yield f"  {'evolved in':<28} {'predicted':>14} {'zero-shot':>14} {'adapted':>14}"
    for environment, style in ENVIRONMENTS.items():
        arm = [score for score in scores if score["environment"] == environment]
        if not arm:
            continue
        columns = {name: [score.get(name) for score in arm] for name in ("predicted", "zero_shot", "adapted")}
        cells = [
            segments.mean_and_deviation([value for value in values if value is not None]) for values in columns.values()
        ]
        yield f"  {style.label:<28} " + " ".join(f"{cell:>14}" for cell in cells)
        sd, fitness = (_mean([score.get(name) for score in arm]) for name in ("predicted_sd", "fitness"))
        if sd is not None and fitness is not None:
            yield f"  {'  σ over members, fitness':<28} {f'{sd:.2f}, {fitness:z.2f}':>14}"
        for words, whole in best.items() if environment != "true_slush" else ():
            if whole is not None and whole > 0:
                parts = [_mean(columns[name]) for name in ("zero_shot", "adapted")]
                percent = ["" if part is None else f"{part / whole:.0%}" for part in parts]
                yield f"  {f'  {words}':<28} {'':>14} " + " ".join(f"{cell:>14}" for cell in percent)


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
