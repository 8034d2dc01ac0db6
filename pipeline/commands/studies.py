"""puddle studies: the studies of a store."""

from dataclasses import asdict

from pipeline.commands.options import DEFAULT_STORE, AsJson, StorePath, print_json, with_options
from pipeline.commands.output import to_stdout


@with_options
def studies(store: StorePath = DEFAULT_STORE, as_json: AsJson = False) -> None:
    """List the studies of a store: what differs from the preset, progress, failures, last change, page."""
    from pipeline.commands.study_list import describe, list_studies
    from pipeline.store.store import Store

    opened = Store.open(store, create=False)
    with opened.lock_to_read():
        listed = list(list_studies(opened))
    if as_json:
        print_json({"store": str(opened.root), "studies": [asdict(one) for one in listed]})
        return
    noun = "study" if len(listed) == 1 else "studies"
    to_stdout(f"{len(listed) or 'no'} {noun} in {opened.root} ({opened.size_bytes() / 1e6:,.1f} MB)")
    for one in listed:
        to_stdout("")
        for line in describe(one):
            to_stdout(line)
