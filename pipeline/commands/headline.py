"""What `puddle study` shows when it is done: the headline figures, where the page is, and what to do next."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from pipeline.config.settings import Settings
from pipeline.stages import segments
from pipeline.stages.report import PAGE
from pipeline.stages.transfer import read_scores
from pipeline.stages.trial_scores import TrialScores, finite_scores
from pipeline.store.store import Store
from pipeline.workflow.stage import Upstream
from tasks.analysis.scores import QUANTITY_WORDS
from tasks.world import ENVIRONMENTS, EnvironmentName


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
    found = read_scores(settings, upstream["transfer"], store)
    arms: dict[EnvironmentName, list[TrialScores | None]] = {}
    for trial, scores in found.items():
        if trial.depth == depth:
            arms.setdefault(trial.environment, []).append(scores)
    of_true_slush = arms.get("true_slush", [])
    best = {
        "share of True Slush": _mean(finite_scores(of_true_slush, "zero_shot")),
        "share of it adapted": _mean(finite_scores(of_true_slush, "adapted")),
    }
    yield f"Champions of study {settings.name} in True Slush, {depth:g} m deep: mean ± SD over trials [m]"
    yield f"selected for: {settings.selected_for}"
    yield f"  {'evolved in':<28} {'predicted':>14} {'zero-shot':>14} {'adapted':>14}"
    for environment, style in ENVIRONMENTS.items():
        if environment not in arms:
            continue
        arm = arms[environment]
        columns = {name: finite_scores(arm, name) for name in QUANTITY_WORDS}
        cells = [segments.mean_and_deviation(values) for values in columns.values()]
        yield f"  {style.label:<28} " + " ".join(f"{cell:>14}" for cell in cells)
        sd, fitness = _mean(finite_scores(arm, "predicted_sd")), _mean(finite_scores(arm, "fitness"))
        if sd is not None and fitness is not None:
            yield f"  {'  σ over members, fitness':<28} {f'{sd:.2f}, {fitness:z.2f}':>14}"
        for words, whole in best.items() if environment != "true_slush" else ():
            if whole is not None and whole > 0:
                parts = [_mean(columns[name]) for name in ("zero_shot", "adapted")]
                percent = ["" if part is None else f"{part / whole:.0%}" for part in parts]
                yield f"  {f'  {words}':<28} {'':>14} " + " ".join(f"{cell:>14}" for cell in percent)


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None
