"""No damaged file is accepted: reading refuses it by name, `puddle verify` finds it, and it alone is recomputed."""

import shutil

import numpy as np
import pytest
from quick_study import QuietTerminal, tree

from pipeline.commands.damage import find_damage, verify
from pipeline.errors import DamagedArtifact
from pipeline.store.store import Store


@pytest.fixture(scope="module")
def pristine(full, tmp_path_factory):
    """A store with a finished study."""
    root = tmp_path_factory.mktemp("pristine") / "store"
    full.drive(root)
    return root


def damaged(good: bytes, kind: str, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(good)))
    match kind:
        case "a flipped bit":
            return good[:at] + bytes([good[at] ^ 1 << int(rng.integers(8))]) + good[at + 1 :]
        case "cut off":
            return good[:at]
        case "longer":
            return good + rng.bytes(10)
        case _:
            return good[:at] + bytes(len(good) - at)


@pytest.mark.parametrize("kind", ["a flipped bit", "cut off", "longer", "zeros at the end", "gone"])
def test_damage_is_named_and_alone_is_recomputed(torture, full, pristine, new_folder, kind):
    for rng in torture.attempts(6, 1000):
        root = new_folder() / "store"
        shutil.copytree(pristine, root)
        files = sorted(path for path in root.glob("items/*/*/*/*") if "report" not in path.parts)
        if kind == "a flipped bit":  # of a manifest, it may lie in what no digest covers, such as the seconds
            files = [path for path in files if path.name != "manifest.json"]
        path = files[int(rng.integers(len(files)))]
        stage, key = path.parts[-4], path.parent.name
        if kind == "gone":
            path.unlink()
        else:
            good = path.read_bytes()
            path.write_bytes(bad := damaged(good, kind, rng))
            if bad == good:
                continue
        store = Store.open(root, create=False)
        assert any(str(path) in str(error) for error in find_damage(store))
        if path.name == "manifest.json" and kind == "gone":
            assert store.manifest(stage, key) is None
        else:
            with pytest.raises(DamagedArtifact, match=str(path)):
                for name in store.manifest(stage, key).files:
                    store.read(store.manifest(stage, key), name)
        verify(store, None, discard=True, progress=QuietTerminal())
        assert full.drive(root).computed == [key]
        assert tree(root) == tree(pristine)
        shutil.rmtree(root)
