"""Digests of a stage's code: an edit of any module that a stage imports counts, and nothing else does."""

import pytest

from pipeline.sources import read_modules
from pipeline.stages import STAGES
from pipeline.store.manifest import Manifest
from pipeline.workflow.code_digest import PACKAGES, digests, is_of_other_code, recorded_code

_, _, EVOLVE, *_ = STAGES
MODULES = read_modules(*PACKAGES)


def digests_with(edited: dict[str, bytes], stage=EVOLVE) -> set[str]:
    return digests([stage.item.__module__, stage.compute.__module__], {**MODULES, **edited})


@pytest.mark.parametrize(
    "module",
    [
        "pipeline.stages.evolve",
        "pipeline.stages.segments",
        "tasks.evolution.afpo",
        "tasks.evolution.objectives.displacement",  # found by pkgutil
        "tasks.simd",  # a package around what is imported
        "tasks.simd.vectors",
        "tasks.world.slush",
    ],
)
def test_an_edit_of_a_module_that_a_stage_imports_counts(module):
    assert not digests_with({}) <= digests_with({module: MODULES[module] + b"\nEDITED = 1\n"})


@pytest.mark.parametrize(
    "module",
    ["pipeline.stages.train", "tasks.residual.training", "tasks.analysis.hallucination", "pipeline.report.page"],
)
def test_an_edit_of_another_module_does_not_count(module):
    assert digests_with({module: b"EDITED = 1\n"}) == digests_with({})


def test_a_module_that_is_added_changes_no_earlier_result():
    for added in ("tasks.world.honey", "tasks.evolution.objectives.grace"):
        assert digests_with({added: b"ADDED = 1\n"}) > digests_with({})


def test_comments_docstrings_and_spaces_do_not_count():
    before = (
        b'"""About."""\nLIMIT = 3\n"""About it."""\n\ndef f(x: int) -> int:\n    """Add."""\n    return x + LIMIT\n'
    )
    after = b'"""More."""\nLIMIT = 3  # of them\n\n\ndef f(x: int) -> int:\n    return (x + LIMIT)\n'
    assert digests(["tasks.f"], {"tasks.f": before}) == digests(["tasks.f"], {"tasks.f": after})
    assert digests(["tasks.f"], {"tasks.f": before.replace(b"3", b"4")}) != digests(["tasks.f"], {"tasks.f": before})


def test_items_of_other_code_are_named():
    now = recorded_code(EVOLVE)

    def is_named(record) -> bool:
        return is_of_other_code(Manifest("evolve", "0" * 64, {}, {}, {}, record), EVOLVE)

    assert not is_named({"code": now}) and not is_named({})
    first, *others = now["modules"].split()
    assert is_named({"code": {"modules": " ".join(["01234567", *others])}})
    assert not is_named({"code": {"modules": " ".join([first, *others, "01234567"])}})  # a medium that is gone
