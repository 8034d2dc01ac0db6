"""The workflow with real stages on tiny settings: the same bytes however it runs, and wherever it stopped before."""

import contextlib
import dataclasses
import re
import shutil

import pytest
from small_study import digests, ignored, labelled, run, silent

from pipeline.cluster import serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.stages import STAGES
from pipeline.store.store import Store
from pipeline.workflow.dispatcher import run_stage
from pipeline.workflow.graph import StageRun, require, results_of, survey
from pipeline.workflow.identity import OutputId
from pipeline.workflow.stage import AnyStage, Execution, Failure, Files, Inputs, Item

TINY = """
name: tiny
throws: {n_throws: 6, n_steps: 20}
network: {hidden_layers: 1, width: 4}
training: {n_iterations: 20, batch_size: 64}
ensemble: {n_members: 2}
grid: {depths: [1.0], single_member_depths: [1.0], n_trials: 1}
rollout: {n_settle: 5, n_measure: 20}
evolution: {n_generations: 4, afpo: {population_size: 4}}
transfer: {n_generations: 3}
work: {throws_per_item: 2, generations_per_item: 2, engine: reference}
"""


def tiny(*overrides: str) -> Settings:
    return parse(Settings, TINY, name="tiny", overrides=overrides)


@pytest.fixture(scope="module")
def serial_run(tmp_path_factory):
    store = Store.open(tmp_path_factory.mktemp("serial") / "store", create=True)
    with serial_cluster() as cluster:
        return store, run(tiny(), store, cluster)


def test_every_chain_of_every_stage_is_done(serial_run):
    _, upstream = serial_run
    for stage in STAGES:
        found = upstream[stage.name]
        assert not found.unfinished and not found.failed
        assert sorted(labelled(found.done)) == sorted(chain.label for chain in stage.plan(tiny()))


def test_nothing_is_computed_twice(serial_run):
    store, upstream = serial_run

    class Refusing:
        n_cores = 1.0

        def submit(self, *arguments, **options):
            raise AssertionError("computed again")

    again = run(tiny(), store, Refusing())
    assert digests(again) == digests(upstream)


def test_ray_gives_the_same_bytes_as_one_process(serial_run, local_ray, tmp_path):
    _, upstream = serial_run
    other = run(tiny(), Store.open(tmp_path / "store", create=True), local_ray, STAGES[:-1])
    assert digests(other) == {k: v for k, v in digests(upstream).items() if not k.startswith("report/")}


def test_the_training_device_is_part_of_a_members_identity(serial_run):
    """On a GPU the last bits differ, so the members differ too; its tasks ask for a GPU."""
    _, upstream = serial_run
    train = next(stage for stage in STAGES if stage.name == "train")

    def specified(*overrides):
        settings = tiny(*overrides)
        return train.item(settings, train.plan(settings)[0], 0, None, upstream)

    core, gpu = specified("training.device=cpu"), specified("training.device=cuda")
    assert core.key == labelled(upstream["train"].done)["member-00"][0].key and core.execution == Execution()
    assert gpu.key != core.key and gpu.execution == Execution(n_gpus=1)


@pytest.mark.parametrize("kind", ["serial", "ray"])
def test_a_missing_gpu_is_reported_at_once(kind, request, serial_run):
    """Ray would wait for one forever."""
    store, _ = serial_run
    with contextlib.ExitStack() as stack:
        cluster = request.getfixturevalue("local_ray") if kind == "ray" else stack.enter_context(serial_cluster())
        if cluster.n_gpus:
            pytest.skip("there is a GPU")
        with pytest.raises(PuddleError, match=r"train of member-00 is to run on a GPU, and there is none.*device=cpu"):
            run(tiny("training.device=cuda"), store, cluster, STAGES[:2])


def test_an_edited_setting_redoes_what_depends_on_it_and_nothing_else(serial_run):
    store, upstream = serial_run
    found = survey(tiny("ensemble.disagreement_penalty=2.0"), STAGES, store, say=silent)
    assert digests({"train": found["train"]}) == digests({"train": upstream["train"]})
    assert {trial.label for trial in found["evolve"].unfinished} == {
        "residual_slush/1m/trial-0",
        "single_member/1m/trial-0",
    }

    more = survey(tiny("evolution.n_generations=8"), STAGES[:4], store, say=silent)
    assert all(n == 2 for n in more["evolve"].n_done.values())  # the first four generations stand


def refusal(name: str, settings: Settings, store: Store) -> str:
    """Return why a stage can't start."""
    upstream = survey(settings, STAGES, store, say=silent)
    (stage,) = (stage for stage in STAGES if stage.name == name)
    with pytest.raises(PuddleError) as refused:
        require(settings, stage, STAGES, upstream, how_to_run=lambda name: f"puddle {name}")
    return str(refused.value)


@pytest.mark.parametrize("name", ["train", "evolve", "transfer", "assess", "analyse", "report"])
@pytest.mark.parametrize("overrides", [(), ("grid.environments=[residual_slush]", "grid.single_member_depths=[]")])
def test_a_stage_whose_inputs_are_missing_says_which_and_how_to_get_them(name, overrides, tmp_path):
    """The first stage to run is named, however far upstream it is."""
    said = refusal(name, tiny(*overrides), Store.open(tmp_path / "store", create=True))
    assert re.match(rf"{name} needs the results of collect.*throws-0.*\n.*`puddle collect`", said), said


def test_an_item_far_upstream_is_missed_too(serial_run, tmp_path):
    store, upstream = serial_run
    lacking = shutil.copytree(store.root, tmp_path / "store")
    (chunk,) = labelled(upstream["collect"].done)["throws-2"]
    Store.open(lacking, create=False).discard("collect", chunk.key)
    said = refusal("evolve", tiny(), Store.open(lacking, create=False))
    assert "evolve needs the results of collect, and 1 of them are missing (the first: throws-2)" in said


def test_statistics_wait_for_every_trial(serial_run):
    """Trials that were never evolved are missing, not failed."""
    store, _ = serial_run
    more = tiny("grid.n_trials=2")
    for name in ("transfer", "assess", "analyse", "report"):
        said = refusal(name, more, store)
        assert f"{name} needs the results of evolve, and 4 of them are missing" in said and "`puddle evolve`" in said


def test_failed_chains_stop_no_stage(serial_run):
    """What depends on them is not possible, and all else goes on."""
    store, upstream = serial_run
    failed = {OutputId("throws-0"): Failure("failed after 2 attempts")}
    lost = dataclasses.replace(upstream["collect"], done={}, failed=failed)
    found = {"collect": lost}
    for stage in STAGES[1:]:
        require(tiny(), stage, STAGES, found, how_to_run=str)
        found[stage.name] = results_of(stage, StageRun(stage, tiny(), found, store, silent).chains())
        if stage.name == "evolve":
            assert set(labelled(found["evolve"].failed)) == {"residual_slush/1m/trial-0", "single_member/1m/trial-0"}
        found[stage.name] = dataclasses.replace(found[stage.name], unfinished=())  # it has run


def _failing(compute, bad: str):
    def fail(item: Item, inputs: Inputs) -> Files:
        if item.spec.trial.identity.environment == bad:
            raise ArithmeticError("no such luck")
        return compute(item, inputs)

    return fail


def test_an_item_that_fails_twice_stops_nothing_else(serial_run, tmp_path):
    """The report of such a study is seen in tests/torture/test_bad_science.py."""
    _, upstream = serial_run
    stages = list(STAGES[:-1])
    stages[3] = dataclasses.replace(STAGES[3], compute=_failing(STAGES[3].compute, "dry_land"))
    said: list[str] = []
    store = Store.open(tmp_path / "store", create=True)
    with serial_cluster() as cluster:
        found = run(tiny(), store, cluster, tuple(stages), said.append)
    assert "no such luck" in labelled(found["evolve"].failed)["dry_land/1m/trial-0"].reason
    assert any("dry_land/1m/trial-0" in line and "2 attempts" in line for line in said)
    untried = labelled(found["transfer"].failed)["dry_land/1m/trial-0"]
    assert not untried.tried and "failed after" in untried.reason
    undisturbed = {label: d for label, d in digests(upstream).items() if not label.startswith("report/")}

    def others(of):
        """Leave out what concerns Dry Land; tables are of all environments."""
        return {label: d for label, d in of.items() if "dry_land" not in label and not label.startswith("analyse/")}

    assert others(digests(found)) == others(undisturbed)
    assert not found["analyse"].failed  # it says what is missing, and goes on

    with serial_cluster() as cluster:  # the cause is mended: the next run computes what failed
        assert digests(run(tiny(), store, cluster, STAGES[:-1])) == undisturbed


def test_a_page_that_fails_is_reported_like_any_item(serial_run, tmp_path):
    def fail(item: Item, inputs: Inputs) -> Files:
        raise ArithmeticError("no ink")

    store, upstream = serial_run
    report = dataclasses.replace(STAGES[-1], version=99, compute=fail, item=_of_version(STAGES[-1], 99))
    page_run = StageRun(report, tiny(), upstream, store, silent)
    chains = page_run.chains()
    with serial_cluster() as cluster:
        run_stage(page_run, chains, cluster=cluster, advance=ignored)
    summary = report.summarise(tiny(), results_of(report, chains), store)
    assert "no ink" in summary.lines[0]


def _of_version(stage: AnyStage, version: int):
    return lambda *arguments: dataclasses.replace(stage.item(*arguments), version=version)


def test_a_damaged_item_is_computed_again(tmp_path):
    store = Store.open(tmp_path / "store", create=True)
    said: list[str] = []
    with serial_cluster() as cluster:
        before = run(tiny(), store, cluster, STAGES[:2])
        (manifest,) = labelled(before["train"].done)["member-01"]
        (path,) = store.root.glob(f"items/train/*/{manifest.key}/weights.safetensors")
        path.write_bytes(path.read_bytes()[:-1])
        after = run(tiny(), store, cluster, STAGES[:2], said.append)
    assert digests(after) == digests(before)
    assert len(said) == 1 and "weights.safetensors" in said[0]
