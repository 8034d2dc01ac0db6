import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.errors import PuddleError
from pipeline.store.design_file import design_document
from pipeline.store.design_table import read_designs
from tasks.design import random_designs

DESIGNS = random_designs(5, np.random.default_rng(3))
DOCUMENTS = [json.dumps(design_document(DESIGNS[i : i + 1])) for i in range(len(DESIGNS))]
COLUMNS = {name: array.tolist() for name, array in DESIGNS.arrays()}


def written(folder, columns):
    pq.write_table(pa.table(columns), folder / "designs.parquet")
    return folder / "designs.parquet"


def test_every_form_of_a_table_gives_the_same_designs(tmp_path):
    (tmp_path / "designs.jsonl").write_text("\n".join(DOCUMENTS) + "\n\n")
    (tmp_path / "design.json").write_text(json.dumps(json.loads(DOCUMENTS[0]), indent=2))
    assert (read_designs(tmp_path / "designs.jsonl").table == DESIGNS.table).all()
    assert (read_designs(tmp_path / "design.json").table == DESIGNS[:1].table).all()
    for columns in ({**COLUMNS, "fitness": [0.0] * 5}, {"trial": list(range(5)), "design_json": DOCUMENTS}):
        assert (read_designs(written(tmp_path, columns)).table == DESIGNS.table).all()


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"phase": None}, "expected a column for each gene, got none for phase"),
        ({"phase": [[0.0] * 5] * 5}, "column phase: expected 6 numbers in every row"),
        ({"phase": [[0.0] * 6] * 4 + [[0.0] * 5]}, "column phase: expected 6 numbers in every row"),
        ({"frequency": ["fast"] * 5}, "column frequency: expected a number in every row"),
        ({"frequency": [0.1, 0.1, 7.0, 0.1, 0.1]}, "design 2: frequency is 7"),
        ({"parent": [[0.5] * 6] * 5}, "column parent: expected 6 numbers"),
    ],
)
def test_a_faulty_column_is_named(tmp_path, changed, said):
    columns = {name: values for name, values in (COLUMNS | changed).items() if values is not None}
    with pytest.raises(PuddleError, match=said):
        read_designs(written(tmp_path, columns))


def test_a_faulty_line_is_named(tmp_path):
    path = tmp_path / "designs.jsonl"
    path.write_text(DOCUMENTS[0] + "\n" + DOCUMENTS[1].replace("phase", "fase") + "\n")
    with pytest.raises(PuddleError, match=r"designs.jsonl, line 2: unknown field fase"):
        read_designs(path)


@pytest.mark.parametrize("content", [b"", b"\n \n", b"\xff\xfe", b"PAR1"])
@pytest.mark.parametrize("name", ["designs.jsonl", "designs.parquet"])
def test_no_table_of_designs(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(PuddleError, match=name):
        read_designs(tmp_path / name)
    with pytest.raises(PuddleError, match="cannot be read: No such file"):
        read_designs(tmp_path / "nosuch.parquet")
