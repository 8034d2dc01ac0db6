"""What `puddle study` shows when it is done: the headline figures, where the page is, and what to do next."""

from collections.abc import Callable, Iterator

from pipeline.config.settings import Settings
from pipeline.report.render import as_text
from pipeline.stages.report import PAGE
from pipeline.stages.transfer import read_trials
from pipeline.store.store import Store
from pipeline.workflow.stage import Upstream
from tasks.analysis.tables.transfer import TOO_WIDE, TransferRow, transfer_rows


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
    depth = max(settings.grid.depths)
    rows = [row for row in transfer_rows(read_trials(settings, upstream["transfer"], store)) if row.depth == depth]
    yield ""
    yield f"Champions of study {settings.name} in True Slush, {depth:g} m deep: mean ± SD over trials [m]"
    yield f"selected for: {settings.selected_for}"
    yield from as_text(TransferRow, rows, TOO_WIDE)
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
