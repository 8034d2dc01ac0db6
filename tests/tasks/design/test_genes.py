"""The table of genes, designs as arrays, and the refusals of designs that are not valid."""

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from tasks.design import GENES, N_LINKS, DesignError, Designs, check, random_designs
from tasks.design.gene import Gene
from tasks.design.genes import DTYPES, columns_of

N_REALS = 41


@pytest.fixture
def designs() -> Designs:
    return random_designs(5, np.random.default_rng(3))


def with_value(designs: Designs, name: str, index: object, value: object) -> Designs:
    array = getattr(designs, name).copy()
    array[index] = value
    return replace(designs, **{name: array})


@pytest.mark.parametrize("name", [name for name in DTYPES if name != "frequency"])
@pytest.mark.parametrize("shape", [(5, N_LINKS - 1), (4, N_LINKS), (5,), (5, N_LINKS, 1)])
def test_a_wrong_shape_is_refused_by_name(designs: Designs, name: str, shape: tuple[int, ...]) -> None:
    with pytest.raises(DesignError, match=re.escape(f"{name} has shape {shape}, expected (n_designs, 6)")):
        replace(designs, **{name: np.zeros(shape)})


@pytest.mark.parametrize("name", list(DTYPES))
def test_equality_sees_every_gene(designs: Designs, name: str) -> None:
    array = getattr(designs, name).copy()
    array.flat[-1] = ~array.flat[-1] if name == "motor_on" else array.flat[-1] + 1
    other, again = replace(designs, **{name: array}), replace(designs)
    assert (designs == other) is False and (designs == again) is True and (designs == array) is False
    assert {designs: "it", other: "another"}[again] == "it"


def test_designs_are_shown_by_their_shapes_and_drawn(designs: Designs) -> None:
    assert repr(designs) == (
        "Designs(length_scale, parent, parent_attachment, child_attachment, rest_angle, phase, motion_range, motor_on "
        "(5, 6); frequency (5,))"
    )
    drawn = ElementTree.fromstring(Designs.concatenate([designs] * 4)._repr_html_())
    assert [len(robot.findall(".//rect")) for robot in drawn.findall("svg")] == [N_LINKS] * 12
    assert (drawn[-1].tail or "") == " and 8 more"
    dots = [dot.get("fill") == "#1d2129" for dot in drawn.iter("circle")]
    assert dots[:25] == designs.motor_on[:, 1:].ravel().tolist()
    far = with_value(designs, "parent", (1, 2), 40)
    assert far._repr_html_() is None and "length_scale" in repr(far)  # what can't be drawn


def test_indexing_chooses_designs(designs: Designs) -> None:
    assert len(designs) == 5 and len(designs[2]) == 1
    assert designs[2].frequency[0] == designs.frequency[2]
    assert designs[1:3] == designs[[1, 2]]
    assert designs[np.array([True, False, False, True, False])] == designs[[0, 3]]
    assert len(designs[np.zeros(0, dtype=np.int64)]) == 0
    np.testing.assert_array_equal(designs[[4, 4, 0]].phase, designs.phase[[4, 4, 0]])
    with pytest.raises(IndexError):
        designs[5]
    assert Designs.concatenate([designs[:2], designs[2:]]) == designs


def test_a_vector_is_a_design_and_back() -> None:
    designs = random_designs(200, np.random.default_rng(4))
    vector = designs.to_vector()
    assert vector.shape == (200, N_REALS) and ((vector >= 0) & (vector <= 1)).all()
    again = Designs.from_vector(vector)
    np.testing.assert_allclose(again.table, designs.table, rtol=0, atol=1e-15)
    assert (again.parent == designs.parent).all() and (again.motor_on == designs.motor_on).all()


@pytest.mark.parametrize("value", [0.0, 1.0, 0.5, np.nextafter(1.0, 0.0)])
def test_every_vector_is_a_valid_design(value: float) -> None:
    check(Designs.from_vector(np.full(N_REALS, value)))
    assert Designs.from_vector([[value] * N_REALS]).parent[0, 2:].tolist() == [
        int(value * i) - (value == 1) for i in range(2, 6)
    ]


OTHER_SHAPE = "expected shape (n_designs, 9 or 17 or 25 or 33 or 41 or 49 or 57 or 65 or 73 or 81 or 89)"


@pytest.mark.parametrize(
    ("vector", "message"),
    [
        (np.zeros(40), f"{OTHER_SHAPE}, got (40,)"),
        (np.zeros((1, 1, 41)), f"{OTHER_SHAPE}, got (1, 1, 41)"),
        (np.full((2, 41), 1.5), "[0, 0], length_scale of link 0, is 1.5, expected 0 to 1"),
        (np.r_[np.zeros(6), np.nan, np.zeros(34)], "[0, 6], parent of link 2, is nan, expected 0 to 1"),
        (np.r_[np.zeros(40), -0.1], "[0, 40], frequency, is -0.1, expected 0 to 1"),
    ],
)
def test_a_vector_that_is_none_is_refused(vector, message: str) -> None:
    with pytest.raises(DesignError, match=re.escape(f"vector: {message}")):
        Designs.from_vector(vector)


def test_what_the_root_ignores_is_not_checked(designs: Designs) -> None:
    check(with_value(designs, "motion_range", (0, 0), np.nan))


NUMBERS = [gene for gene in GENES if gene.kind != "flag"]


@pytest.mark.parametrize("gene", NUMBERS, ids=lambda gene: gene.name)
@pytest.mark.parametrize("fault", ["nan", "inf", "-inf", "above", "below"])
def test_a_gene_out_of_bounds_is_named(designs: Designs, gene: Gene, fault: str) -> None:
    value = {"above": np.nextafter(gene.high, np.inf), "below": np.nextafter(gene.low, -np.inf)}.get(fault)
    value = float(fault) if value is None else value
    index = (3, 4) if gene.per_link else (3,)
    with pytest.raises(DesignError) as refused:
        check(with_value(designs, gene.name, index, value))
    where = " of link 4" if gene.per_link else ""
    expected = f"expected {gene.low:.6g} to {gene.high:.6g} {gene.unit}"
    assert str(refused.value) == f"design 3: {gene.name}{where} is {value}, {expected}"


@pytest.mark.parametrize(
    ("link", "parent", "expected"),
    [
        (3, 3, "a link before it, 0 to 2"),
        (3, 4, "a link before it, 0 to 2"),
        (1, 1, "a link before it, 0 to 0"),
        (4, -1, "a link before it, 0 to 3"),
        (5, 6, "a link before it, 0 to 4"),
        (0, 0, "-1 (it is the root)"),
        (0, -2, "-1 (it is the root)"),
    ],
)
def test_a_broken_tree_is_named(designs: Designs, link: int, parent: int, expected: str) -> None:
    with pytest.raises(DesignError) as refused:
        check(with_value(designs, "parent", (2, link), parent))
    assert str(refused.value) == f"design 2: parent of link {link} is {parent}, expected {expected}"


def test_a_table_holds_designs_exactly_and_can_not_be_made_untrue(designs: Designs) -> None:
    assert designs.table.shape == (len(designs), 49)
    restored = Designs.from_table(designs.table[::-1].copy())
    assert restored == designs[::-1]
    for name, array in restored.arrays():
        np.testing.assert_array_equal(array.reshape(len(designs), -1), restored.table[:, columns_of(N_LINKS)[name]])
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    with pytest.raises(ValueError, match="read-only"):
        restored.table[0] = 0


@pytest.mark.parametrize(("name", "value"), [("parent", 1.5), ("motor_on", 0.5)])
def test_a_value_that_its_type_would_change_is_refused_by_name(name, value):
    arrays = dict(random_designs(2, np.random.default_rng(0)).arrays())
    arrays[name] = arrays[name].astype(float)
    arrays[name][1, 3] = value
    with pytest.raises(DesignError, match=f"{name}: expected values of type"):
        Designs(**arrays)
