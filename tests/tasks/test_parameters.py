"""Parameters: what is impossible is refused by name, and a group shows what differs from its defaults."""

import pytest
from pydantic import ValidationError

from tasks.design import Morphology, Mutation
from tasks.evolution import Afpo
from tasks.world import Slush


def test_a_group_shows_what_differs_from_its_defaults_and_can_be_made_of_that():
    assert repr(Slush()) == "Slush()"
    afpo = Afpo(population_size=16, mutation=Mutation(step=0.2))
    assert repr(afpo) == "Afpo(population_size=16, mutation=Mutation(step=0.2))" and eval(repr(afpo)) == afpo


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
