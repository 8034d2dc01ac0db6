"""No damaged file is accepted: reading refuses it by name, `puddle verify` finds it, and it alone is recomputed.

The store contains a whole study: tables, weights, designs, figures, manifests, the study's record and its report. Loose
files, which a person may edit, cannot be sealed. A damaged design, settings, calibration or timeline file is either
refused by name, and by field if a value has the wrong type, or it is another valid file. For settings, the study then
says which ones changed.
"""

import copy
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from pipeline.commands.damage import damaged_items, find_damage
from pipeline.config.loading import load
from pipeline.config.settings import Settings
from pipeline.errors import DamagedArtifact, PuddleError
from pipeline.fabrication.kit_files import calibration_yaml, read_calibration, read_timeline, timeline_json
from pipeline.store.design_file import read_design
from pipeline.store.store import Store
from pipeline.workflow.record import differences
from tasks.fabrication.calibration import Calibration, ServoCalibration
from tasks.fabrication.timeline import Timeline

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def pristine(fork_server, tmp_path_factory):
    """A store with a finished study."""
    root = tmp_path_factory.mktemp("pristine") / "store"
    fork_server.finish([root], study="full")
    return root


@pytest.fixture
def store(pristine, new_folder) -> Store:
    """A copy of the store, to be damaged."""
    root = new_folder() / "store"
    shutil.copytree(pristine, root)
    return Store.open(root, create=False)


def files_of(root: Path) -> list[Path]:
    return sorted(path for path in root.rglob("*") if path.is_file() and path.suffix != ".lock")


def damage(path: Path, others: list[Path], rng: np.random.Generator) -> list[Path]:
    """Damage a file, or swap it with another one; return the files that changed."""
    good = path.read_bytes()
    kind = rng.choice(["flip", "flip", "flip", "cut", "more", "zeros", "gone", "folder", "swap"])
    if kind == "folder" and "items" not in path.parts:
        kind = "gone"  # a folder in place of a report file belongs to the user: the study says so and stops
    bad = bytearray(good)
    match kind:
        case "flip":
            bit = int(rng.integers(8 * len(good)))
            bad[bit // 8] ^= 1 << bit % 8
        case "cut":
            del bad[int(rng.integers(len(good))) :]
        case "more":
            bad += rng.bytes(int(rng.integers(1, 100)))
        case "zeros":
            begin = int(rng.integers(len(good)))
            bad[begin : begin + 512] = bytes(len(bad[begin : begin + 512]))
        case "gone" | "folder":
            path.unlink()
            if kind == "folder":
                path.mkdir()
            return [path]
        case "swap":
            other = others[int(rng.integers(len(others)))]
            theirs = other.read_bytes()
            path.write_bytes(theirs)
            other.write_bytes(good)
            return [path, other] if theirs != good else []
    path.write_bytes(bad)
    return [path] if bad != good else []


def mend(path: Path, good: bytes) -> None:
    if path.is_dir():
        path.rmdir()
    path.write_bytes(good)


def named(bad: list[Path], said: list[str]) -> bool:
    """Return whether messages name each damaged file.

    If a study's record is damaged, the content of its report is unknown, so naming the record names both. If an item's
    manifest is damaged, the content of the item's files is unknown.
    """
    lost = {path.parent / "report" for path in bad if path.name == "study.json"}
    lost |= {path.parent for path in bad if path.name == "manifest.json"}
    to_name = [path for path in bad if path.name == "manifest.json" or path.parent not in lost]
    return all(any(str(path) in line for line in said) for path in to_name)


N_AT_ONCE = 10
"""Files damaged before the store is verified: hashing all of it takes as long for one as for ten."""


def chosen(files: list[Path], rng: np.random.Generator) -> list[Path]:
    """Choose files to damage, half of them as partners of swaps.

    Files that describe others (a study's record; a report's manifest, which describes the copies) are damaged alone.
    """
    shuffled = [files[index] for index in rng.permutation(len(files))]
    describes = [path.match("study.json") or path.match("items/report/*/*/manifest.json") for path in shuffled]
    to_damage = [path for path, alone in zip(shuffled, describes, strict=True) if not alone or path == shuffled[0]]
    return to_damage[: 2 if describes[0] else 2 * N_AT_ONCE]


def test_every_damage_is_found_and_named(torture, store):
    files = [path for path in files_of(store.root) if path.name != "store.json"]
    items = [path for path in files if "items" in path.parts and "report" not in path.parts]
    good = {path: path.read_bytes() for path in files}
    n_of: dict[str, int] = {}
    n_attempts = n_damages = 0
    for n_attempts, rng in enumerate(torture.attempts(300 // N_AT_ONCE, 50_000 // N_AT_ONCE), 1):
        while n_damages < n_attempts * N_AT_ONCE:  # files that describe others are damaged alone
            paths, n_wanted = chosen(files, rng), n_attempts * N_AT_ONCE - n_damages
            alone = len(paths) == 2
            partners = [items[int(rng.integers(len(items)))]] if alone else paths[1::2]
            pairs = list(zip(paths[::2], partners, strict=False))[:n_wanted]
            damaged = [changed for one, other in pairs if (changed := damage(one, [other], rng))]
            bad = [path for changed in damaged for path in changed]
            said = [str(error) for error in find_damage(store)]
            assert named(bad, said), (bad, said)
            n_damages += len(damaged)
            for path in bad:
                n_of[path.suffix] = n_of.get(path.suffix, 0) + 1
                mend(path, good[path])
    assert find_damage(store) == []
    assert n_damages == n_attempts * N_AT_ONCE and (torture.large or n_damages == 300)
    n_damaged = ", ".join(f"{number:,} {suffix}" for suffix, number in sorted(n_of.items()))
    torture.note(f"{n_damages:,} damages, to {n_damaged}: all found and named")


def test_no_damaged_item_is_read(torture, store):
    items = [(stage, key) for stage in store.stages() for key in store.keys(stage)]
    for rng in torture.attempts(300, 10_000):
        stage, key = items[int(rng.integers(len(items)))]
        files = files_of(store._item(stage, key))
        good = {path: path.read_bytes() for path in files}
        bad = damage(files[int(rng.integers(len(files)))], files, rng)
        gone = any(path.name == "manifest.json" and not path.exists() for path in bad)
        if gone:  # then the item does not exist
            assert store.manifest(stage, key) is None
        elif bad:
            with pytest.raises(DamagedArtifact) as refusal:
                for name in store.manifest(stage, key).files:
                    store.read(store.manifest(stage, key), name)
            assert (refusal.value.stage, refusal.value.key) == (stage, key)
            assert any(str(path) in str(refusal.value) for path in bad)
        for path in bad:
            mend(path, good[path])


def a_damaged_copy(pristine: Path, root: Path, rng: np.random.Generator) -> list[Path]:
    """Copy a store and damage one to five of its files, or more by swaps; return those that changed."""
    shutil.copytree(pristine, root)
    files, touched = [path for path in files_of(root) if path.name != "store.json"], set()
    for path in rng.choice(files, size=int(rng.integers(1, 6)), replace=False):
        if path.is_file():
            touched.update(damage(path, [other for other in files if other.is_file()], rng))
    good = {path: (pristine / path.relative_to(root)).read_bytes() for path in touched}
    return sorted(path for path in touched if not path.is_file() or path.read_bytes() != good[path])


def keys_of(bad: list[Path]) -> set[str]:
    """Return the keys of the items that files belong to; copies of a report and a study's record belong to none."""
    return {path.parent.name for path in bad if "items" in path.parts}


def test_only_damaged_items_are_recomputed(torture, fork_server, pristine, new_folder):
    (undisturbed,) = fork_server.finish([pristine], study="full")
    n_damaged = 0
    for rng in torture.attempts(12, 2000):
        root = new_folder() / "store"
        bad = a_damaged_copy(pristine, root, rng)
        damaged = keys_of(bad)
        found = {key for _, key in damaged_items(find_damage(Store.open(root, create=False)))}
        listed = not any(path.name == "study.json" for path in bad)  # without the record, no item is missed
        gone = {path.parent.name for path in bad if path.name == "manifest.json" and not path.exists()}
        assert found == (damaged if listed else damaged - gone)
        (answer,) = fork_server.finish([root], study="full", discard=True)
        assert set(answer["computed"]) == damaged
        assert answer["tree"] == undisturbed["tree"]
        n_damaged += len(damaged)
        shutil.rmtree(root)
    torture.note(f"{n_damaged:,} damaged items recomputed, and no other")


def test_a_run_recomputes_the_damage_it_meets_and_nothing_else(torture, fork_server, pristine, new_folder):
    """Without `puddle verify`, a run notices missing files, wrong lengths, and damage in what it reads."""
    (undisturbed,) = fork_server.finish([pristine], study="full")
    n_met = n_left = 0
    for rng in torture.attempts(8, 1000):
        root = new_folder() / "store"
        bad = a_damaged_copy(pristine, root, rng)
        lengths = {path: (pristine / path.relative_to(root)).stat().st_size for path in bad}
        plain = [path for path in bad if not path.is_file() or path.stat().st_size != lengths[path]]
        to_be_met = keys_of([*plain, *(path for path in bad if path.name == "manifest.json")])
        answer = fork_server.drive(root, study="full")
        assert answer["status"] == 0 and "error" not in answer, answer
        computed = set(answer["computed"])
        assert to_be_met <= computed <= keys_of(bad)
        left = [path for path in bad if path.parent.name in keys_of(bad) - computed]
        differ = {name for name, _ in answer["tree"].items() ^ undisturbed["tree"].items()}
        assert differ == {str(path.relative_to(root)) for path in left}
        assert named(left, answer["wrong"]) and len(answer["wrong"]) == len(keys_of(left))
        n_met, n_left = n_met + len(computed), n_left + len(keys_of(left))
        shutil.rmtree(root)
    torture.note(f"{n_met:,} damaged items met and recomputed, {n_left:,} left that verify names, and no other")


def test_a_store_whose_store_json_is_damaged_is_refused(torture, store):
    path = store.root / "store.json"
    good, others = path.read_bytes(), files_of(store.root / "studies")
    for rng in torture.attempts(100, 2000):
        shutil.copy(others[0], others[0].with_suffix(".copy"))
        if path in damage(path, [others[0].with_suffix(".copy")], rng):
            with pytest.raises(PuddleError, match=str(store.root)):
                Store.open(store.root, create=False)
            mend(path, good)


SERVOS = Calibration(
    servos=tuple(
        ServoCalibration(
            joint=joint,
            channel=joint,
            centre_us=1500.0,
            direction=1,
            us_per_rad=640.0,
            min_us=700.0,
            max_us=2300.0,
            max_speed=5.0,
        )
        for joint in (2, 4)
    )
)
MOTION = Timeline(joints=(2, 4), angle=np.linspace(-0.5, 0.5, 40).reshape(20, 2))

LOOSE = {
    "design.json": lambda: (ROOT / "docs/design.json").read_bytes(),
    "settings.yaml": lambda: (ROOT / "configs/smoke.yaml").read_bytes(),
    "calibration.yaml": lambda: calibration_yaml(SERVOS, "two servos"),
    "timeline.json": lambda: timeline_json(MOTION, SERVOS),
}
"""Files that a person may edit, by name."""


def meaning(path: Path):
    match path.name:
        case "design.json":
            return {name: array.tolist() for name, array in read_design(path).arrays()}
        case "settings.yaml":
            return load(Settings, path).model_dump(mode="json")
        case "calibration.yaml":
            return read_calibration(path).model_dump(mode="json")
        case "timeline.json":
            timeline = read_timeline(path)
            return {"joints": list(timeline.joints), "angle": timeline.angle.tolist()}


@pytest.mark.parametrize("name", LOOSE)
def test_a_damaged_loose_file_is_refused_by_name_or_means_something_else(torture, tmp_path, name):
    good, path = LOOSE[name](), tmp_path / name
    path.write_bytes(good)
    meant, n_refused, n_other = meaning(path), 0, 0
    for rng in torture.attempts(500, 10_000):
        bad = bytearray(good)
        bit = int(rng.integers(8 * len(good)))
        bad[bit // 8] ^= 1 << bit % 8
        path.write_bytes(bad if rng.random() < 0.8 else good[: int(rng.integers(len(good)))])
        try:
            means = meaning(path)
        except PuddleError as error:
            assert str(path) in str(error)
            n_refused += 1
        else:
            n_other += bool(differences(meant, means))
    torture.note(f"{n_refused:,} refused by name, {n_other:,} valid and different, the rest in a comment or a space")


def values(document, at=()):
    """List the paths of the single values of a document, except those that identify it and those that are not read."""
    if not isinstance(document, dict | list):
        return [at] if document is not None else []
    inner = document.items() if isinstance(document, dict) else enumerate(document)
    apart = () if at else ("schema", "version", "channels", "pulse_us")
    return [path for key, value in inner if key not in apart for path in values(value, (*at, key))]


@pytest.mark.parametrize("name", LOOSE)
def test_a_value_of_another_type_is_refused_by_name_and_field(torture, tmp_path, name):
    path = tmp_path / name
    path.write_bytes(LOOSE[name]())
    document = json.loads(path.read_bytes()) if path.suffix == ".json" else meaning(path)
    paths = values(document)
    for rng in torture.attempts(100, 5000):
        *above, last = path_of_value = paths[int(rng.integers(len(paths)))]
        group = bad = copy.deepcopy(document)
        for key in above:
            group = group[key]
        others = [3, 0.5] if isinstance(group[last], str) else ["soup", "3"]
        others += [[], {}, [group[last]], *([] if isinstance(group[last], bool) else [True])]
        group[last] = others[int(rng.integers(len(others)))]
        path.write_text(json.dumps(bad))  # which YAML is, too
        field = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path_of_value).removeprefix(".")
        field = path_of_value[0] if path.suffix == ".json" else field
        with pytest.raises(PuddleError) as refusal:
            meaning(path)
        assert str(path) in str(refusal.value) and f" {field}: " in str(refusal.value), (path_of_value, group[last])
    torture.note(f"each refused by its field, of {len(paths):,} values")
