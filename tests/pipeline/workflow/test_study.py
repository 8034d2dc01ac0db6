"""The workflow with real stages on tiny settings: the same bytes however it runs, and wherever it stopped before."""

import re
import shutil

import pytest
from small_study import ON_DRY_LAND, digests, labelled, run
from small_study import one_trial as tiny

from pipeline.cluster import serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.stages import STAGES
from pipeline.stages.adapt import ADAPT
from pipeline.stages.evolve import EVOLVE
from pipeline.store.store import Store
from pipeline.workflow.graph import require, survey
from pipeline.workflow.stage import Execution


def test_every_chain_of_every_stage_is_done_and_computed_once(serial_run):
    store, upstream = serial_run
    for stage in STAGES:
        found = upstream[stage.name]
        assert not found.unfinished and not found.failed
        assert sorted(labelled(found.done)) == sorted(chain.label for chain in stage.plan(tiny()))

    class Refusing:
        n_cores = 1.0

        def submit(self, *arguments, **options):
            raise AssertionError("computed again")

    assert digests(run(tiny(), store, Refusing())) == digests(upstream)


def test_two_workers_give_the_same_bytes_as_one_process(serial_run, local_ray, tmp_path):
    _, upstream = serial_run
    store = Store.open(tmp_path / "store", create=True)
    other = run(tiny(), store, local_ray, STAGES[:-1])
    assert digests(other) == {k: v for k, v in digests(upstream).items() if not k.startswith("report/")}


def test_batches_on_two_workers_give_the_same_bytes_as_trials_in_one_process(local_ray, tmp_path):
    def evolved(cluster, engine):
        few = ("grid.n_trials=8", "evolution.afpo.population_size=2", f"work.engine={engine}")
        settings = parse(Settings, ON_DRY_LAND, name="tiny", overrides=few)
        return digests(run(settings, Store.open(tmp_path / engine, create=True), cluster, [EVOLVE, ADAPT]))

    with serial_cluster() as serial:
        assert evolved(local_ray, "batch") == evolved(serial, "reference")


def test_the_training_device_is_part_of_a_members_identity(serial_run):
    """On a GPU the last bits differ, so the members differ too; its tasks ask for a GPU."""
    _, upstream = serial_run
    train = next(stage for stage in STAGES if stage.name == "train")

    def specified(*overrides):
        settings = tiny(*overrides)
        return train.item(settings, train.plan(settings)[0], 0, None, upstream)

    core, gpu = specified("training.device=cpu"), specified("training.device=cuda")
    assert (
        core.key == labelled(upstream["train"].done)["residual_slush/member-00"][0].key
        and core.execution == Execution()
    )
    assert gpu.key != core.key and gpu.execution == Execution(n_gpus=1)


def test_a_missing_gpu_is_reported_at_once(serial_run, local_ray):
    """Ray would wait for one forever."""
    store, _ = serial_run
    with serial_cluster() as serial:
        for cluster in (serial, local_ray):
            if cluster.n_gpus:
                pytest.skip("there is a GPU")
            with pytest.raises(PuddleError, match=r"member-00 is to run on a GPU, and there is none.*device=cpu"):
                run(tiny("training.device=cuda"), store, cluster, STAGES[:2])


def test_an_edited_setting_redoes_what_depends_on_it_and_nothing_else(serial_run):
    store, upstream = serial_run
    found = survey(tiny("ensemble.disagreement_penalty=2.0"), STAGES, store).upstream
    assert digests({"train": found["train"]}) == digests({"train": upstream["train"]})
    assert {trial.label for trial in found["evolve"].unfinished} == {
        "residual_slush/1m/trial-0",
        "single_member/1m/trial-0",
    }

    more = survey(tiny("evolution.n_generations=8"), STAGES[:3], store).upstream
    assert all(n == 2 for n in more["evolve"].n_done.values())  # the first four generations stand


def refusal(name: str, settings: Settings, store: Store) -> str:
    """Return why a stage can't start."""
    upstream = survey(settings, STAGES, store).upstream
    (stage,) = (stage for stage in STAGES if stage.name == name)
    with pytest.raises(PuddleError) as refused:
        require(settings, stage, STAGES, upstream)
    return str(refused.value)


@pytest.mark.parametrize("name", ["train", "evolve", "adapt", "transfer", "assess", "analyse", "report"])
def test_a_stage_whose_inputs_are_missing_says_which_and_how_to_get_them(name, serial_run, tmp_path):
    """The first stage to run is named, however far upstream it is; trials never evolved are missing, not failed."""
    store, upstream = serial_run
    said = refusal(name, tiny(), Store.open(tmp_path / "empty", create=True))
    assert re.match(rf"{name} needs the results of collect.*throws-0.*\n.*`puddle collect`", said), said
    lacking = Store.open(shutil.copytree(store.root, tmp_path / "store"), create=False)
    lacking.discard("collect", labelled(upstream["collect"].done)["residual_slush/throws-2"][0].key)
    said = refusal(name, tiny(), lacking)
    assert (
        f"{name} needs the results of collect, and 1 of them are missing (the first: residual_slush/throws-2)" in said
    )
    if name not in ("train", "evolve"):
        said = refusal(name, tiny("grid.n_trials=2"), store)
        assert f"{name} needs the results of evolve, and 4 of them are missing" in said and "`puddle evolve`" in said


def test_a_damaged_item_alone_is_computed_again(serial_run, tmp_path):
    store, before = serial_run
    (manifest,) = labelled(before["train"].done)["residual_slush/member-01"]
    damaged = Store.open(shutil.copytree(store.root, tmp_path / "store"), create=False)
    (path,) = damaged.root.glob(f"items/train/*/{manifest.key}/weights.safetensors")
    path.write_bytes(path.read_bytes()[:-1])
    said: list[str] = []
    with serial_cluster() as cluster:
        submit, submitted = cluster.submit, []
        cluster.submit = lambda *given, **options: submitted.append(options["name"]) or submit(*given, **options)
        after = run(tiny(), damaged, cluster, STAGES, said.append)
    assert digests(after) == digests(before)
    assert len(said) == 1 and "weights.safetensors" in said[0]
    assert len(submitted) == 1 and "member-01" in submitted[0]
