"""A study with learners of its own beside Residual Slush, from the throws to the page, as a user runs it."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from command_line import WITHOUT_MLFLOW, call
from pydantic_core import to_jsonable_python
from small_study import TINY

import puddle
from pipeline.commands.proposal import proposed
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.stages.report import PAGE
from pipeline.store.design_file import design_json
from tasks.design import random_designs

LISTED = (
    "name=listed",
    "grid.environments=[true_slush,dry_land,residual_slush,five,one_of_five]",
    "learners.five={throws: {n_throws: 5}, network: {form: wetted, width: 8}, n_members: 3}",
    "learners.one_of_five.single=five",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("listed")
    (folder / "tiny.yaml").write_text(TINY)
    changes = [word for change in LISTED for word in ("--set", change)]
    where = ["--settings", str(folder / "tiny.yaml"), "--store", str(folder / "store")]
    assert call("study", "--workers", "0", *WITHOUT_MLFLOW, *where, *changes) == 0
    return folder


def test_learners_of_a_study_are_arms_like_others(folder):
    study = puddle.open_study("listed", folder / "store")
    champions = study.champions().to_pylist()
    arms = {row["environment"] for row in champions}
    assert {"residual_slush", "single_member", "five", "one_of_five"} <= arms and len(champions) == 2 * len(arms)
    members = study.table("learning_curves").to_pydict()
    networks = {*zip(members["data_set"], members["member"], strict=True)}
    assert networks == {*(("residual_slush", k) for k in range(2)), *(("five", k) for k in range(3))}
    throws = study.table("transitions").to_pydict()
    assert len({throw for of, throw in zip(throws["data_set"], throws["throw"], strict=True) if of == "five"}) == 5
    for name, n_members in (("residual_slush", 2), ("five", 3), ("one_of_five", 1)):
        assert len(study.table("histories", environment=name)["displacement"][0]) == n_members
    assert study.ensemble(learner="five").n_members == 3
    assert {"residual_slush", "five"} == set(study.table("regressions")["learned_from"].to_pylist())


def test_the_robot_to_build_and_the_page_s_commands_are_of_their_own_learner(folder):
    study = puddle.open_study("listed", folder / "store")
    page = (folder / "store" / "studies" / "listed" / "report" / PAGE).read_text()
    assert "Five, Ê" in page and "One of five, Ê" in page and "learned from 5 throws" in page
    arms = ("five", "one_of_five", "residual_slush")
    assert len({re.search(rf"--arm-{name}: (#\w+)", page)[1] for name in arms}) == len(arms)
    replays = json.loads(re.search(r'id="replays">(.*?)</script>', page)[1])
    commands = {(replay["environment"], replay["command"]) for replay in replays}
    assert {("five", "five"), ("one_of_five", ""), ("residual_slush", "residual_slush")} <= commands
    few = study.settings.grid.model_copy(update={"environments": ("true_slush", "dry_land", "five")})
    source = proposed(replace(study, settings=study.settings.model_copy(update={"grid": few})))
    assert "evolved with the networks of five" in source.origin and len(source.predicted) == 3


def test_a_design_is_simulated_under_a_learner(folder, capsys):
    design = folder / "design.json"
    design.write_bytes(design_json(random_designs(1, np.random.default_rng(3))))
    where = ("--study", "listed", "--store", str(folder / "store"), "--depth", "1")
    assert call("simulate", str(design), "--environment", "five", *where) == 0
    said = capsys.readouterr().out
    assert call("simulate", str(design), "--environment", "one_of_five", *where) == 2
    assert said.startswith("Five, 1 m deep") and said.count(", ", said.index("members")) == 2


def test_learners_change_no_work_item_of_other_arms():
    """What they add is theirs alone: their throws, networks and trials."""
    plain, listed = (parse(Settings, TINY, name="tiny", overrides=overrides) for overrides in ((), LISTED))
    for stage in (stage for stage in STAGES if stage.name not in ("analyse", "report")):
        before, after = (
            {chain.label: to_jsonable_python(chain.spec) for chain in stage.plan(one)} for one in (plain, listed)
        )
        assert {label: after[label] for label in before} == before
        assert all("five" in label for label in after.keys() - before.keys())
