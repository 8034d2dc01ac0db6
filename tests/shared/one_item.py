"""An item for the tests of the store, and a look at what lies on the disk."""

from pathlib import Path

from pipeline.store.encoding import key_of
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store

IDENTITY = {"stage": "evolve", "version": 1, "spec": {"depth": 0.5}, "inputs": {}}
KEY = key_of(IDENTITY)
FILES = {"history.parquet": b"rows" * 100, "state.safetensors": b"\0\1\2" * 50, "log": b""}
RECORD = {"seconds": 1.25}


def commit(store: Store, files: dict[str, bytes] = FILES) -> Manifest:
    return store.commit("evolve", IDENTITY, files, record=RECORD)


def item(store: Store) -> Path:
    return store.root / "items" / "evolve" / KEY[:2] / KEY


def tree(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}
