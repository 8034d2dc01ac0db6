"""puddle ui: MLflow's own pages."""

from typing import Annotated

import typer

from pipeline.commands.exit_codes import interruptible
from pipeline.commands.options import DEFAULT_STORE, StorePath, with_options


@with_options
def ui(
    store: StorePath = DEFAULT_STORE,
    port: Annotated[int, typer.Option("--port", min=1, max=65535, help="Port on the loopback interface.")] = 5000,
) -> None:
    """Serve the MLflow UI on this machine's loopback interface."""
    from pipeline.store.store import Store
    from pipeline.tracking.mirror import serve_ui

    with interruptible():
        serve_ui(Store.open(store, create=False).root, port)
