"""assess and analyse on a real study: numbers equal those of other stages to the last bit, and gaps are gaps."""

import numpy as np
import pytest
from small_study import files_of, inputs_of, labelled

from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.stages.analyse import ANALYSE, table_file
from pipeline.stages.assess import ASSESS
from pipeline.stages.files import HISTORY, PREDICTIONS
from pipeline.stages.reader import read_study
from pipeline.workflow.identity import TrialId
from tasks.analysis.tables import ANALYSES
from tasks.design import Designs
from tasks.design.genes import DTYPES

ARMS = ("true_slush", "dry_land", "residual_slush", "single_member")


def computed(settings, upstream, store, change=lambda inputs: inputs):
    """Compute every analysis, with inputs that may be changed; return the columns of each by label."""
    tables = {}
    for chain in ANALYSE.plan(settings):
        item = ANALYSE.item(settings, chain, 0, None, upstream)
        files = ANALYSE.compute(item, change(inputs_of(store, item)))
        tables[chain.label] = table_file(ANALYSES[chain.spec.analysis]).read([files])
    return tables


@pytest.fixture(scope="module")
def tables(study):
    """Columns by label: the analysis, and its arm if there is one."""
    store, upstream = study
    return {
        label: table_file(ANALYSES[label.split("/")[0]]).read([files_of(store, done)])
        for label, (done,) in labelled(upstream["analyse"].done).items()
    }


@pytest.fixture(scope="module")
def predictions(study):
    store, upstream = study
    return PREDICTIONS.read([files_of(store, done) for (done,) in upstream["assess"].done.values()])


@pytest.fixture(scope="module")
def scores(settings, study):
    store, upstream = study
    trials = read_study(settings, upstream, store).trials
    return {(scored.environment, scored.depth, scored.trial): scored for scored in trials}


def rows(table, *names):
    return zip(*(table[name].tolist() for name in names), strict=True)


def test_assessed_designs_are_those_of_the_histories(settings, study, predictions):
    store, upstream = study
    assert len(predictions["true"]) == settings.assess.n_designs
    assert set(predictions["environment"]) == {"true_slush", "dry_land"}
    counts = np.unique([f"{e}/{t}" for e, t in rows(predictions, "environment", "trial")], return_counts=True)[1]
    assert sorted(counts) == [5, 5, 5, 6]
    for environment in ("true_slush", "dry_land"):
        segments = upstream["evolve"].done[TrialId("evolve", environment, 1.0, 0)]
        history = HISTORY.read([files_of(store, segment) for segment in segments])
        mine = (predictions["environment"] == environment) & (predictions["trial"] == 0)
        at = np.searchsorted(history["identity"], predictions["identity"][mine])
        drawn = Designs(**{name: predictions[name][mine] for name in DTYPES})
        assert drawn == Designs.from_arrays(history)[at]
        assert (history["generation"][at] == predictions["generation"][mine]).all()
        if environment == "true_slush":  # simulated anew, and the same to the last bit
            assert predictions["true"][mine].tolist() == history["displacement"][at, 0].tolist()


def test_champions_repeat_the_scores_of_evolution_and_transfer(tables, scores):
    """Where each evolved, with one member or all, and in True Slush: the same numbers to the last bit."""
    columns = ("environment", "depth", "trial", "zero_shot", "predicted")
    assert {tuple(who): values for *who, values in rows(tables["scores"], *columns[:3], "zero_shot")} == {
        who: one.zero_shot for who, one in scores.items()
    }
    ranked, networks = tables["exploiters"], ("residual_slush", "single_member")
    predicted = {tuple(who): p for *who, p in rows(ranked, "environment", "depth", "trial", "predicted")}
    assert {who: p for who, p in predicted.items() if who[0] in networks} == {
        who: one.predicted for who, one in scores.items() if who[0] in networks
    }


def test_a_study_without_networks_gets_what_needs_none(settings, study, tables):
    """Its trials are the study's own, so the store holds them; only the analysis is new."""
    store, upstream = study
    grid = settings.grid.model_copy(update={"environments": ("true_slush", "dry_land"), "single_member_depths": ()})
    without = Settings.model_validate(settings.model_copy(update={"grid": grid}).model_dump())
    assert not without.needs_ensemble and ASSESS.plan(without) == []
    upstream = {**upstream, **{name: type(upstream[name])(name, {}) for name in ("collect", "train", "assess")}}
    found = {
        name: len(table["depth"]) for name, table in computed(without, upstream, store).items() if "depth" in table
    }
    assert found["scores"] == 4
    assert "exploiters" not in found


def test_failed_trials_leave_the_rest(settings, study):
    store, upstream = study
    lost = [TrialId("transfer", "dry_land", 1.0, trial) for trial in range(2)]
    found = upstream["transfer"]
    done = {trial: chain for trial, chain in found.done.items() if trial not in lost}
    cut = type(found)("transfer", done, dict.fromkeys(lost, "failed: no such luck"))
    tables = computed(settings, {**upstream, "transfer": cut}, store)
    scores = tables["scores"]
    status = dict(zip(rows(scores, "environment", "trial"), scores["status"].tolist(), strict=True))
    assert status["dry_land", 1] == "not done" and status["true_slush", 1] == "ok"


def test_the_assessed_depth_is_the_papers_or_the_deepest():
    def depth_of(text):
        return parse(Settings, text, name="s").assessed_depth

    assert depth_of("name: s") == 9
    assert depth_of("name: s\ngrid: {depths: [2.0, 0.5]}") == 2
    assert depth_of("name: s\ngrid: {depths: [2.0, 0.5]}\nassess: {depth: 0.5}") == 0.5


def test_summary_gives_every_table_to_read_and_the_metrics_by_which_studies_are_compared(settings, study):
    store, upstream = study
    summary = ANALYSE.summarise(settings, upstream, store)
    assert summary.of_study
    assert {"scores.csv", "paper.csv", "exploiters.csv"} <= set(summary.artifacts)
    metrics = ("accuracy.r.mean", "accuracy.slope.mean_less_1_sd", "hallucinated.worst_champion")
    assert {"m.residual_slush", "share.residual_slush", *metrics} <= set(summary.metrics)
