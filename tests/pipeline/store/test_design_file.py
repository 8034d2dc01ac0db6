"""Designs in files: every form gives the same designs, and what is wrong is named."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.errors import PuddleError
from pipeline.store.design_file import design_document, design_from, read_designs
from tasks.design import random_designs

DESIGNS = random_designs(5, np.random.default_rng(3))
DOCUMENTS = [json.dumps(design_document(DESIGNS[i : i + 1])) for i in range(len(DESIGNS))]
COLUMNS = {name: array.tolist() for name, array in DESIGNS.arrays()}


def written(folder, columns):
    pq.write_table(pa.table(columns), folder / "designs.parquet")
    return folder / "designs.parquet"


def test_every_form_of_a_table_gives_the_same_designs(tmp_path):
    (tmp_path / "design.json").write_text(json.dumps(json.loads(DOCUMENTS[0]), indent=2))
    assert (read_designs(tmp_path / "design.json").table == DESIGNS[:1].table).all()
    for columns in ({**COLUMNS, "fitness": [0.0] * 5}, {"trial": list(range(5)), "design_json": DOCUMENTS}):
        assert (read_designs(written(tmp_path, columns)).table == DESIGNS.table).all()


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"phase": None}, "expected a column for each gene, got none for phase"),
        ({"phase": [[0.0] * 5] * 5}, r"column phase: expected fixed_size_list<.*double>\[6\] in every row"),
        ({"phase": [[0.0] * 6] * 4 + [[0.0] * 5]}, "column phase: expected"),
        ({"frequency": ["fast"] * 5}, "column frequency: expected double in every row, got string"),
        ({"frequency": [0.1, 0.1, 7.0, 0.1, 0.1]}, "design 2: frequency is 7"),
        ({"parent": [[0.5] * 6] * 5}, "column parent: expected"),
        ({"design_json": [*DOCUMENTS[:4], "{}"]}, "row 4: expected 'puddle.design' version 1"),
        ({name: [] for name in COLUMNS}, "expected at least one design, got none"),
    ],
)
def test_a_faulty_column_is_named(tmp_path, changed, said):
    columns = {name: values for name, values in (COLUMNS | changed).items() if values is not None}
    with pytest.raises(PuddleError, match=said):
        read_designs(written(tmp_path, columns))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"schema": "other"}, "expected 'puddle.design' version 1, got 'other'"),
        ({"version": 2}, "got version 2"),
        ({"fase": 1}, "fase: Extra inputs are not permitted, got 1"),
        ({"phase": [0.0] * 5}, "phase: List should have at least 6 items"),
        ({"phase": [0.0] * 5 + ["0"]}, "phase.5: Input should be a valid number, got 0"),
        ({"motor_on": [1] * 6}, "motor_on.0: Input should be a valid boolean, got 1"),
        ({"parent": [-1, 0, 0, 0, 0, 2**70]}, "int"),
        ({"frequency": 7.0}, "the file: frequency is 7"),
    ],
)
def test_a_faulty_field_is_named(changed, said):
    document = json.loads(DOCUMENTS[0])
    assert (design_from(document, "the file").table == DESIGNS[:1].table).all()
    with pytest.raises(PuddleError, match=f"the file: .*{said}|{said}"):
        design_from(document | changed, "the file")


def test_no_table_of_designs(tmp_path):
    (tmp_path / "designs.parquet").write_bytes(b"PAR1")
    with pytest.raises(PuddleError, match=r"designs.parquet: expected a Parquet file or a design file"):
        read_designs(tmp_path / "designs.parquet")
