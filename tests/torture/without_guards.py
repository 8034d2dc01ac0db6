"""A pytest plugin that repeats some tests with one guard removed, and passes them if they fail.

tests/conftest.py loads it, so each repetition runs beside its test, as ``test_name[without the hash of a file]``.
"""

import contextlib
import os
import resource
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import pipeline.cluster.process
import pipeline.cluster.serial
import pipeline.store.encoding
import pipeline.store.items
import pipeline.store.manifest
import pipeline.store.store
from pipeline.store import disk
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store

ROOT = Path(__file__).parents[2]

STORE, ARTIFACTS = "tests/pipeline/store/test_store.py::test_", "tests/pipeline/store/test_encoding.py::test_"
PROCESS = "tests/pipeline/cluster/test_process.py::test_"
EVOLUTION = "tests/tasks/evolution/"
FAULTS, REFUSALS = (
    "tests/pipeline/store/test_store_faults.py::test_",
    "tests/pipeline/store/test_store_refusals.py::test_",
)


def unread(store: Store, manifest: Manifest, name: str) -> bytes:
    """Read a file without checking its hash."""
    return (store._item(manifest.stage, manifest.key) / name).read_bytes()


def unsealed(data: bytes, *, schema: str, version: int, source: str) -> dict:
    """Read a document without checking its seal."""
    value = pipeline.store.encoding.decode_json(data, source)
    return {name: inner for name, inner in value.items() if name not in ("schema", "version", "sha256")}


def everything_is_finite() -> SimpleNamespace:
    return SimpleNamespace(isfinite=lambda value: True)


def every_array_is_finite() -> SimpleNamespace:
    """Return NumPy with an ``isfinite`` that is always true."""
    return SimpleNamespace(**{**vars(np), "isfinite": lambda values: np.ones_like(values, dtype=bool)})


def in_place(path, data: bytes) -> None:
    """Write a file directly at its final path."""
    disk.write(path, data)
    disk.fsync(path)
    disk.fsync(path.parent)


def open_to_all(name: str) -> Callable[..., int | None]:
    """Grant a lock even if it is taken, if its file has that name. A query for its owner is answered truthfully."""
    try_lock = disk.try_lock

    def take(path, *, only_ask: bool = False, **execution) -> int | None:
        if path.name != name or only_ask:
            return try_lock(path, only_ask=only_ask, **execution)
        return os.open(path, os.O_RDWR | os.O_CREAT)

    return take


def any_name(patch: pytest.MonkeyPatch) -> None:
    for module in (pipeline.store.items, pipeline.store.store):
        patch.setattr(module, "check_name", lambda name, what: name)


def unbounded() -> SimpleNamespace:
    """Return the module ``resource`` with a ``setrlimit`` that does nothing."""
    return SimpleNamespace(**{**vars(resource), "setrlimit": lambda *limits: None})


GUARDS: dict[str, tuple[str, Callable[[pytest.MonkeyPatch], None]]] = {
    "hash of a file": (
        REFUSALS + "no_flipped_bit_is_accepted[history.parquet]",
        lambda patch: patch.setattr(Store, "read", unread),
    ),
    "seal of a manifest": (
        REFUSALS + "no_flipped_bit_is_accepted[manifest.json]",
        lambda patch: patch.setattr(pipeline.store.manifest, "decode_sealed", unsealed),
    ),
    "label of a table": (
        ARTIFACTS + "a_flipped_bit_never_changes_a_value_silently[arrays]",
        lambda patch: patch.setattr(pipeline.store.encoding, "_check_label", lambda *said: None),
    ),
    "temporary file": (
        FAULTS + "a_study_record_is_the_old_or_the_new_one",
        lambda patch: patch.setattr(disk, "place", in_place),
    ),
    "lock of a study": (
        STORE + "a_study_has_one_driver_which_is_named_to_a_second",
        lambda patch: patch.setattr(disk, "try_lock", open_to_all("driver.lock")),
    ),
    "lock of a store against gc": (
        FAULTS + "whoever_removes_and_whoever_drives_refuse_one_another",
        lambda patch: patch.setattr(disk, "try_lock", open_to_all("use.lock")),
    ),
    "lock of a commit": (
        FAULTS + "nothing_changes_but_under_the_commit_lock",
        lambda patch: patch.setattr(disk, "locked", lambda path: contextlib.nullcontext()),
    ),
    "look at what was written": (
        REFUSALS + "a_disk_that_writes_other_bytes_is_found_out",
        lambda patch: patch.setattr(disk, "digest", lambda data: ""),
    ),
    "refusal of names": (REFUSALS + "hostile_names_are_refused[../x]", any_name),
    "bound of a task's memory": (
        PROCESS + "a_task_that_allocates_without_end_fails_and_the_bound_goes_with_it",
        lambda patch: patch.setattr(pipeline.cluster.process, "resource", unbounded()),
    ),
    "bound around every task": (
        "tests/pipeline/cluster/test_cluster.py::test_a_task_is_bounded_in_its_memory[serial]",
        lambda patch: patch.setattr(pipeline.cluster.serial, "memory_bounded", contextlib.nullcontext),
    ),
    "refusal of links": (
        REFUSALS + "symbolic_links_are_refused_at_every_level[1]",
        lambda patch: patch.setattr(disk, "inside", lambda root, *parts: root.joinpath(*parts)),
    ),
    "equality of what is computed twice": (
        STORE + "a_result_computed_twice_must_be_equal",
        lambda patch: patch.setattr("pipeline.store.manifest.refuse_other_content", lambda kept, new: None),
    ),
    "check that a training's loss is finite": (
        "tests/tasks/residual/test_training.py::test_data_that_are_not_finite_end_a_training_by_name[nan]",
        lambda patch: patch.setattr("tasks.residual.training._check_finite", lambda *losses: None),
    ),
    "check that a survivor's fitness is finite": (
        EVOLUTION + "test_afpo.py::test_a_fitness_that_is_not_finite_is_never_selected_and_never_dominates[inf]",
        lambda patch: patch.setattr("tasks.evolution.afpo.np", every_array_is_finite()),
    ),
    "check that a design got somewhere with every member": (
        EVOLUTION + "objectives/test_evaluation.py::test_one_diverged_member_is_enough[nan]",
        lambda patch: patch.setattr("tasks.evolution.objectives.evaluation.np", every_array_is_finite()),
    ),
    "refusal of numbers that are not finite": (
        ARTIFACTS + "what_json_has_no_exact_form_for_is_refused[inf-ValueError-is inf]",
        lambda patch: patch.setattr(pipeline.store.encoding, "math", everything_is_finite()),
    ),
}


WITHOUT = pytest.StashKey[str]()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in [*items]:
        for guard, (test, _) in GUARDS.items():
            if item.nodeid == test and isinstance(item, pytest.Function):
                name = f"{item.name}[without the {guard}]"
                again = pytest.Function.from_parent(
                    item.parent,
                    name=name,
                    callspec=getattr(item, "callspec", None),
                    callobj=item.obj,
                    fixtureinfo=item._fixtureinfo,
                    originalname=item.originalname,
                )
                again.stash[WITHOUT] = guard
                items.insert(items.index(item) + 1, again)


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> Iterator[None]:
    guard = pyfuncitem.stash.get(WITHOUT, None)
    if guard is None:
        return (yield)
    patch = pyfuncitem._request.getfixturevalue("monkeypatch")
    GUARDS[guard][1](patch)
    try:
        yield
    except (AssertionError, pytest.fail.Exception) as failure:
        last = Path(traceback.extract_tb(failure.__traceback__)[-1].filename)
        if any(last.is_relative_to(ROOT / package) for package in ("tasks", "pipeline", "tests/torture")):
            raise  # something else failed: the removal of the guard, or what it broke
        return True
    finally:
        patch.undo()
    pytest.fail(f"the test passes without the {guard}", pytrace=False)
