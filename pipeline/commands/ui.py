"""puddle ui: MLflow's own pages."""

from typing import Annotated

import typer

from pipeline.commands.exit_codes import interruptible
from pipeline.commands.options import DEFAULT_STORE, StorePath, TrackingUri, with_options


@with_options
def ui(
    store: StorePath = DEFAULT_STORE,
    tracking_uri: TrackingUri = None,
    study: Annotated[str | None, typer.Option("--study", help="Show the runs of this study; default all.")] = None,
    port: Annotated[int, typer.Option("--port", min=1, max=65535, help="Port on the loopback interface.")] = 5000,
) -> None:
    """Show a store's studies in MLflow, and print the address of their runs."""
    from pipeline.store.store import Store
    from pipeline.tracking.server import show_ui

    with interruptible():
        root = store if tracking_uri else Store.open(store, create=False).root
        show_ui(root, port, uri=tracking_uri or None, study=study)
