"""Settings of a study: learners state what differs from its own groups, and every mistake is named."""

import json

import pytest

from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.errors import PuddleError

LISTED = """name: mine
throws: {n_throws: 30}
network: {width: 32, form: wetted}
learners:
  fifty: {throws: {n_throws: 500}, network: {form: plain}, n_members: 3}
  one_of_fifty: {single: fifty}
grid: {environments: [true_slush, residual_slush, fifty, one_of_fifty], single_member_depths: []}
"""


def test_a_learner_is_the_study_s_groups_with_what_it_states():
    """Values that it states count even where they are the defaults, also once the settings have been recorded."""
    settings = parse(Settings, LISTED, name="mine")
    written = settings.model_dump(mode="json")
    stated = {"throws": {"n_throws": 500}, "network": {"form": "plain"}, "n_members": 3}
    of_every_study = parse(Settings, "", name="mine").model_dump(mode="json")["learners"]
    assert written["learners"] == of_every_study | {"fifty": stated, "one_of_fifty": {"single": "fifty"}}
    assert of_every_study["law_and_network"] == {"network": {"form": "law_and_network"}}
    for same in (settings, Settings.model_validate(json.loads(json.dumps(written)))):
        fifty, one, usual = (same.learner(name) for name in ("fifty", "one_of_fifty", "residual_slush"))
        own = (fifty.throws.n_throws, fifty.network.form, fifty.network.width, fifty.n_members)
        assert own == (500, "plain", 32, 3)
        assert (usual.throws, usual.network, usual.n_members) == (settings.throws, settings.network, 8)
        assert fifty.training == usual.training == settings.training
        assert (one.data_set, one.is_single, one.network) == ("fifty", True, fifty.network)
        assert list(same.ensembles) == ["residual_slush", "fifty"] and same.learner("true_slush") is None
        assert all(same.is_adapted(name) for name in same.grid.environments)
        stating = "LearnerSettings(throws={'n_throws': 500}, network={'form': 'plain'}, n_members=3)"
        assert stating in repr(same) and repr(same).count("\n") == 6


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (["learners.dry_land={}"], "learners.dry_land: the name is taken: expected one of its own, got 'dry_land'"),
        (
            ["throws.source=tracks", "tracks={file: a.csv}", "learners.a.throws.n_throws=20"],
            "learners.a.throws states n_throws, but its throws are the tracked ones of the file",
        ),
        (["learners.Fifty={}"], "learners.Fifty.[key]: String should match pattern"),
        (["learners=[a]"], 'learners: expected an object, got ["a"]'),
        (["learners.a.throws.n_throws=0"], "learners.a.throws.n_throws: expected greater than or equal to 2"),
        (["learners.a.network.form=wet"], "learners.a.network.form: expected any of law, law_and_network, plain"),
        (["network.form=law:honey"], "network.form: expected the law of a fluid with constants, any of true_slush"),
        (["learners.a.network.form=law:dry_land"], "learners.a.network.form: expected the law of a fluid"),
        (
            ["throws.n_throws=2", "grid.environments=[true_slush,law]"],
            "throws.n_throws is 2 for law, but law:true_slush has the constants density, linear_drag, angular_drag: "
            "expected at least 3",
        ),
        (
            ["throws={source: tracks, n_throws: 2}", "tracks={file: a.csv}", "target=tank_model", "network.form=law"],
            "throws.n_throws is 2 for tank_model, but law:true_slush has the constants density, linear_drag",
        ),
        (
            ["throws={source: tracks, design: struck}", "tracks={file: a.csv}", "target=tank_model"],
            "throws.design is struck and throws.source is tracks, but nobody knows what struck a tracked bar",
        ),
        (["randomised_slush.density=[1.25]"], "randomised_slush.density[1]: expected a value, got none"),
        (["learners.a.network.frm=plain"], "unknown setting; did you mean learners.a.network.form?"),
        (["slush.decay=3"], "--set slush.decay=3: slush.decay: unknown setting; did you mean training.decay?"),
        (["n_steps=3"], "n_steps: unknown setting; did you mean throws.n_steps?"),
        (["learners.a.n_members=0"], "learners.a.n_members: expected greater than 0, got 0"),
        (["learners.a.single=b"], "learners.a.single is 'b': expected"),
        (
            ["learners.a={single: residual_slush, n_members: 3}"],
            "learners.a.single is 'residual_slush' beside n_members: expected",
        ),
        (
            ["learners.a.training.learning_rate=0.001", "training={learning_rate: 0.1, min_learning_rate: 0.01}"],
            "learners.a, with the study's groups: min_learning_rate",
        ),
        (["learners.a.throws.source=tracks"], "learners.a.throws.source is tracks, but throws.source is not"),
        (["target=honey"], "target: expected an environment of one medium, any of true_slush, anisotropic_slush"),
        (["target=dry_land"], "target: expected an environment of one medium"),
        (["target=residual_slush"], "target: expected an environment of one medium"),
        (["target=randomised_slush"], "target: expected an environment of one medium"),
        (["target=3"], "target: expected a valid string"),
        (["target=flowing_slush", "slush.density=2"], "neither target nor grid.environments has true_slush"),
        (["flowing_slush.current=1"], "flowing_slush is given, but neither target nor grid.environments has flowing"),
        (["grid.environments=[fifty]"], "grid.environments: expected any of true_slush"),
        (["transfer.engines=[batch,bullet]"], "transfer.engines: expected any of batch, reference, mujoco"),
        (["transfer.engines=[batch,mujoco]", "target=mujoco_fluid"], "is a part of the engine mujoco: expected batch"),
        (["transfer.adapted_environments=[mud]"], "transfer.adapted_environments: expected any of true_slush"),
        (["evolution.controller=wet"], "evolution.controller: expected any of open_loop, phase, reflex, got 'wet'"),
        (["evolution.search=annealing"], "evolution.search: expected any of afpo, cma_es, map_elites, got 'annealing'"),
        (["evolution.objective=third_half_speed"], "evolution.objective: expected any of"),
        (["evolution.objective_depths=[1,2]"], "objective_depths are given, but objective is displacement"),
        (["evolution={objective: mean_over_depths, objective_depths: [1, 1]}"], "objective_depths repeats a value"),
        (["evolution.objective=mean_over_depths", "grid.depths=[1]"], "grid.depths where they are null, has 1"),
        (["evolution={objective: mean_over_depths, objective_depths: [3]}"], "has 1 depth: expected at least 2"),
        (["evolution.objective=displacement_per_energy", "physics.max_motor_torque=0"], "max_motor_torque is 0"),
        (["evolution={objective: displacement_per_energy, morphology: {n_actuated: 0}}"], "morphology.n_actuated is 0"),
        (["physics.continuous_collision=true"], "work.engine is batch, which lacks it: expected work.engine=reference"),
        (["physics.passive_joints=locked"], "passive_joints is locked, so motors decide which links form"),
        (
            ["evolution={controller: reflex, morphology: {unjoined_links: apart_in_gait}}"],
            "morphology constrains gaits, but evolution.controller reflex needs angle",
        ),
        (["rollout.n_settle=0", "tank={}"], "rollout.n_settle is 0, but a robot in the tank"),
        (["grid.depths=[2.0,1.0,2.0]"], "depths (to six digits) repeats a value"),
        (["grid.single_member_depths=[123.4567,123.4568]"], "single_member_depths (to six digits) repeats a value"),
    ],
)
def test_a_mistake_is_named(overrides, said):
    with pytest.raises(PuddleError) as refused:
        parse(Settings, "name: mine", name="mine.yaml", overrides=overrides)
    assert said in str(refused.value) and "\n" not in str(refused.value)


def test_designs_evolve_in_the_target_unless_arms_are_stated():
    """Settings of the slush are accepted where an arm uses it."""
    flowing = parse(Settings, "", name="mine", overrides=["target=flowing_slush"])
    assert flowing.grid.environments == ("flowing_slush", "dry_land", "residual_slush")
    assert Settings.model_validate(flowing.model_dump(mode="json")) == flowing and not flowing.has_papers_target
    assert Settings().has_papers_target
    arms = ["target=flowing_slush", "slush.density=2", "grid.environments=[true_slush]"]
    assert parse(Settings, "", name="mine", overrides=arms).grid.environments == ("true_slush",)
    assert not parse(Settings, "", name="mine", overrides=["slush.density=2"]).has_papers_target


def test_single_members_evolve_only_at_depths_of_the_grid():
    settings = parse(Settings, "grid: {depths: [123.456, 123.457], n_trials: 1}", name="mine")
    assert {depth for _, depth, _ in settings.trials()} == {123.456, 123.457}
