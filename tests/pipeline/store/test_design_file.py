"""Designs in files: every form gives the same designs, and what is wrong is named."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.errors import PuddleError
from pipeline.store.design_file import design_from, design_json, open_designs
from tasks.design import random_designs
from tasks.design.controllers import CONTROLLERS

DESIGNS = random_designs(5, np.random.default_rng(3))
REFLEX = random_designs(5, np.random.default_rng(3), controller="reflex")
DOCUMENTS = [design_json(DESIGNS[i : i + 1]).decode() for i in range(len(DESIGNS))]
COLUMNS = {name: array.tolist() for name, array in DESIGNS.arrays()}


def written(folder, columns):
    pq.write_table(pa.table(columns), folder / "designs.parquet")
    return folder / "designs.parquet"


def test_every_form_of_a_table_gives_the_same_designs(tmp_path):
    (tmp_path / "design.json").write_text(DOCUMENTS[0])
    assert (open_designs(tmp_path / "design.json").table == DESIGNS[:1].table).all()
    for columns in (
        {**COLUMNS, "fitness": [0.0] * 5, "score.mean": [0.0] * 5},
        {"trial": list(range(5)), "design_json": DOCUMENTS},
    ):
        assert (open_designs(written(tmp_path, columns)).table == DESIGNS.table).all()


def test_genes_of_a_controller_are_kept_and_checked(tmp_path):
    columns = {name: array.tolist() for name, array in REFLEX.arrays()}
    assert open_designs(written(tmp_path, columns)) == REFLEX
    assert design_from(design_json(REFLEX[1:2]), "the file") == REFLEX[1:2]
    for number in (float("nan"), float("inf")):
        columns["reflex.spin"][2][3] = number
        with pytest.raises(PuddleError, match=rf"design 2: reflex.spin of link 3 is {number}, expected -0.5 to 0.5 s"):
            open_designs(written(tmp_path, columns))


SHORT = r"phase.load has shape \(5, 5\), expected that of phase"


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"phase": None}, "expected every gene, got none for phase"),
        ({"phase": [[0.0] * 5] * 5}, r"phase has shape \(5, 5\), expected \(n_designs, 6\)"),
        ({"phase": [[0.0] * 6] * 4 + [[0.0] * 5]}, "phase: expected numbers, equally many of each design"),
        ({"frequency": ["fast"] * 5}, r"frequency: expected numbers, .*, got \['fast'"),
        ({"frequency": [0.1, 0.1, 7.0, 0.1, 0.1]}, "design 2: frequency is 7"),
        ({"frequency": [0.1, 0.1, None, 0.1, 0.1]}, "frequency: expected numbers"),
        ({"parent": [[0.5] * 6] * 5}, "parent: expected values of type int64"),
        ({"design_json": [*DOCUMENTS[:4], "{}"]}, "row 4: expected 'puddle.design' version 1"),
        ({name: [] for name in COLUMNS}, "expected at least one design, got none"),
        ({"mine.wet": [[0.0] * 6] * 5}, "controller: expected any of open_loop, .*, got 'mine'"),
        ({"reflex.wet": [[0.0] * 6] * 5}, "expected every gene, got none for reflex.angle, reflex.speed"),
        ({**{gene.name: [[0.0] * 6] * 5 for gene in CONTROLLERS["phase"].genes}, "phase.load": [[0.0] * 5] * 5}, SHORT),
        ({"reflex.wet": [[0.0] * 6] * 5, "phase.load": [[0.0] * 6] * 5}, "genes of the controllers phase and reflex"),
        ({"design_json": [*DOCUMENTS[:4], design_json(REFLEX[:1]).decode()]}, "controllers open_loop, reflex, exp"),
    ],
)
def test_a_faulty_column_is_named(tmp_path, changed, said):
    columns = {name: values for name, values in (COLUMNS | changed).items() if values is not None}
    with pytest.raises(PuddleError, match=said):
        open_designs(written(tmp_path, columns))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"schema": "other"}, "expected 'puddle.design' version 1, got 'other'"),
        ({"version": 2}, "got version 2"),
        ({"phase": [0.0] * 5 + ["0"]}, "phase: expected numbers, .*'0'"),
        ({"parent": [-1, 0, 0, 0, 0, 2**70]}, "parent: expected numbers"),
        ({"frequency": 7.0}, "frequency is 7"),
        ({"girth": 1.0}, "expected the genes length_scale, .*, got girth, too"),
    ],
)
def test_a_faulty_field_is_named(changed, said):
    assert (design_from(DOCUMENTS[0].encode(), "the file").table == DESIGNS[:1].table).all()
    with pytest.raises(PuddleError, match=f"the file: .*{said}"):
        design_from(json.dumps(json.loads(DOCUMENTS[0]) | changed).encode(), "the file")


def test_no_table_of_designs(tmp_path):
    (tmp_path / "designs.parquet").write_bytes(b"PAR1")
    with pytest.raises(PuddleError, match=r"designs.parquet: expected a Parquet file or a design file"):
        open_designs(tmp_path / "designs.parquet")
