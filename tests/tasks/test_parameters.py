"""Parameters: what is impossible is refused by name, and choices that were added leave older results their keys."""

import pytest
from pydantic import ValidationError

from tasks.design import Morphology, Mutation
from tasks.evolution import Afpo
from tasks.parameters import Parameters, later_choice
from tasks.world import Physics, RandomisedSlushes, Slush


class _Group(Parameters):
    old: float = 1.0
    new: str = later_choice("as before")


def test_json_omits_a_later_choice_where_it_has_its_default():
    assert _Group().model_dump(mode="json") == {"old": 1.0}
    assert _Group(new="otherwise").model_dump(mode="json") == {"old": 1.0, "new": "otherwise"}
    for group in (_Group(), _Group(new="otherwise")):
        assert _Group.model_validate(group.model_dump(mode="json")) == group


def test_a_group_shows_what_differs_from_its_defaults_and_can_be_made_of_that():
    assert (repr(_Group()), repr(_Group(old=2.0))) == ("_Group()", "_Group(old=2.0)")
    afpo = Afpo(population_size=16, mutation=Mutation(step=0.2))
    assert repr(afpo) == "Afpo(population_size=16, mutation=Mutation(step=0.2))" and eval(repr(afpo)) == afpo


def test_what_the_paper_leaves_open_is_not_in_the_json_of_what_was_computed_before():
    before = {Physics: 11, Slush: 3, RandomisedSlushes: 5, Mutation: 3, Afpo: 5}  # fields that these groups had
    assert {group: len(group().model_dump(mode="json")) for group in before} == before


IMPOSSIBLE = {
    Morphology: [{"n_actuated": 6}, {"n_actuated": -1}, {"unjoined_links": "near"}, {"max_joint_speed": 0.0}],
    Mutation: [{"genes_changed": -1}, {"genes_changed": 38}, {"step": 0}, {"rewiring": 1.1}, {"rewire": 0.1}],
    Afpo: [{"random_share": 0.5}, {"population_size": 1}, {"mutation_share": -0.1}, {"elitism": True}],
    Slush: [{"density": -1}, {"linear_drag": float("nan")}, {"viscosity": 1}],
}


@pytest.mark.parametrize(("group", "setting"), [(group, of) for group, every in IMPOSSIBLE.items() for of in every])
def test_what_is_impossible_is_refused_by_name(group, setting):
    with pytest.raises(ValidationError, match=next(iter(setting))):
        group(**setting)
