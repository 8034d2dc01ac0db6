"""puddle ui: the studies of a store in MLflow."""

from typing import Annotated

import typer

from pipeline.commands.options import DEFAULT_STORE, OptionalStudy, StorePath, TrackingUri, with_options
from pipeline.mlflow.server import show_ui
from pipeline.store.store import Store


@with_options
def ui(
    study: OptionalStudy = None,
    store: StorePath = DEFAULT_STORE,
    tracking_uri: TrackingUri = None,
    port: Annotated[int, typer.Option("--port", min=1, max=65535, help="Port on the loopback interface.")] = 5000,
) -> None:
    """Show a store's studies, or the runs of one, in MLflow."""
    root = store if tracking_uri else Store.open(store, create=False).root
    show_ui(root, port, uri=tracking_uri or None, study=study)
