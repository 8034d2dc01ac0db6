"""Choices that were added to settings: older results keep their JSON, and so their keys."""

from tasks.design import Mutation
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


def test_what_the_paper_leaves_open_is_not_in_the_json_of_what_was_computed_before():
    before = {Physics: 11, Slush: 3, RandomisedSlushes: 5, Mutation: 3, Afpo: 5}  # fields that these groups had
    assert {group: len(group().model_dump(mode="json")) for group in before} == before
