"""puddle verify: whether every byte of a store is as it was committed."""

from contextlib import nullcontext
from typing import Annotated

import typer

from pipeline.commands.options import DEFAULT_STORE, StorePath, to_copy, with_options
from pipeline.commands.terminal import INCOMPLETE, to_stdout
from pipeline.errors import DamagedArtifact
from pipeline.store.store import Store
from pipeline.workflow.progress import progress


@with_options
def verify(
    store: StorePath = DEFAULT_STORE,
    discard: Annotated[
        bool, typer.Option("--discard", help="Remove damaged items; the next run computes them again.")
    ] = False,
) -> None:
    """Hash a store again; name what is damaged."""
    opened = Store.open(store, create=False)
    with opened.lock_all() if discard else nullcontext(), progress() as show:
        n_items = len(list(opened.items()))
        with show.stage("verify", total=n_items) as advance:
            wrong = opened.verify(checked=lambda: advance(1))
        damaged = [(one.stage, one.key) for one in wrong if isinstance(one, DamagedArtifact) and one.stage and one.key]
        for stage, key in damaged if discard else ():
            opened.discard(stage, key)
    if not wrong:
        to_stdout(f"{opened.root}: {n_items:,} items: every byte is as it was committed.")
        return
    to_stdout(*map(str, wrong), f"{opened.root}: {len(wrong)} problems in {n_items:,} items.")
    if damaged and discard:
        to_stdout("What is damaged is discarded: `puddle study` computes it again.")
    elif damaged:
        discarding = f"`{to_copy('verify --discard', store)}`"
        to_stdout(f"{discarding} removes what is damaged; then `puddle study` computes it again.")
    raise typer.Exit(INCOMPLETE)
