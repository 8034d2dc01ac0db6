"""assess and analyse on a real study: numbers equal those of other stages to the last bit, and gaps have reasons."""

import numpy as np
import pytest
from scipy import stats
from small_study import labelled

from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.stages.analyse import ANALYSE
from pipeline.stages.analyses.analysis_tables import read_reasons, read_table
from pipeline.stages.assess import ASSESS, ASSESSED, PREDICTIONS, AssessmentId, read_predictions
from pipeline.stages.data_sets import DataSetId, NetworkId
from pipeline.stages.transfer import SCORE, SCORED, read_scores
from pipeline.store.encoding import decode_json, decode_table, encode_json, encode_table
from pipeline.workflow.identity import InputName, TrialId
from tasks.analysis.novelty import SPACE
from tasks.design import Designs
from tasks.design.genes import DTYPES


def files_of(store, manifest):
    return {name: store.read(manifest, name) for name in manifest.files}


def inputs_of(store, item):
    return {name: {f: store.read(of.manifest, f) for f in of.files} for name, of in item.inputs.items()}


@pytest.fixture(scope="module")
def analyses(study):
    store, upstream = study
    return {label: files_of(store, done) for label, (done,) in labelled(upstream["analyse"].done).items()}


@pytest.fixture(scope="module")
def predictions(study):
    store, upstream = study
    return read_predictions([files_of(store, done) for (done,) in upstream["assess"].done.values()])


@pytest.fixture(scope="module")
def scores(study, settings):
    store, upstream = study
    found = read_scores(settings, upstream["transfer"], store)
    return {(trial.environment, trial.depth, trial.index): scores for trial, scores in found.items()}


def specified(stage, settings, upstream, label):
    """The item of a chain of one, as the study specifies it."""
    chain = next(chain for chain in stage.plan(settings) if chain.label == label)
    return stage.item(settings, chain, 0, None, upstream)


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
        parts = [store.read(segment, "history.parquet") for segment in segments]
        tables = [decode_table(part, schema="history", version=1, source="") for part in parts]
        history = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
        mine = (predictions["environment"] == environment) & (predictions["trial"] == 0)
        at = np.searchsorted(history["identity"], predictions["identity"][mine])
        drawn = Designs(**{name: predictions[name][mine] for name in DTYPES})
        assert drawn.equals(Designs.from_arrays(history)[at])
        assert (history["generation"][at] == predictions["generation"][mine]).all()
        if environment == "true_slush":  # simulated anew, and the same to the last bit
            assert predictions["true"][mine].tolist() == history["displacement"][at, 0].tolist()


def test_regressions_are_scipys_on_the_predictions(analyses, predictions):
    table = read_table(analyses["statistics"], "regressions")
    for i, name in enumerate(table["name"]):
        x = {
            "member 1": predictions["predicted"][:, 1],
            "mean": predictions["predicted"].mean(axis=1),
            "mean - 1 sd": predictions["predicted"].mean(axis=1) - predictions["predicted"].std(axis=1),
        }.get(name)
        if x is not None:
            expected = stats.linregress(x, predictions["true"])
            assert table["n"][i] == len(x) == 21
            found = [table[figure][i] for figure in ("slope", "intercept", "r")]
            assert found == pytest.approx([expected.slope, expected.intercept, expected.rvalue], rel=1e-9)
    drawn = read_table(analyses["statistics"], "histograms")
    assert drawn["name"].tolist() == ["member 0", "member 1", "mean", "mean - 1 sd"]
    assert (drawn["counts"].sum(axis=1) + drawn["n_outside"] == 21).all()


def test_champions_repeat_the_scores_of_evolution_and_transfer(analyses, scores):
    """Where each evolved, with one member or all, and in True Slush: the same numbers to the last bit."""
    ranked = read_table(analyses["exploiters"], "exploiters")
    columns = ("environment", "depth", "trial", "predicted", "kind")
    predicted = {tuple(who): predicted for *who, predicted, kind in rows(ranked, *columns) if kind == "champion"}
    assert set(predicted) == set(scores)
    tests = read_table(analyses["transfer-matrix"], "tests")
    at_home = {
        (environment, trained, trial): (root, whole)
        for environment, trained, trial, tested, root, whole in rows(tests, *tests)
        if trained == tested
    }
    for (environment, depth, trial), of in scores.items():
        table = read_table(analyses[f"instruments/{environment}/{depth:g}m"], "champions")
        i = table["trial"].tolist().index(trial)
        assert table["claimed"][i] == of.fitness
        assert (table["slush_displacement"][i], table["slush_com"][i]) == (of.zero_shot, of.zero_shot_com)
        assert at_home[environment, depth, trial] == (of.zero_shot, of.zero_shot_com)
        if environment in ("residual_slush", "single_member"):
            assert predicted[environment, depth, trial] == of.predicted == table["home_displacement"][i]
        assert table["n_tries"][i] == 32 and table["n_diverged"][i] == 0
        assert table["loss"][i] == pytest.approx(table["claimed"][i] - table["again"][i], abs=1e-12)


def test_links_cover_every_step_of_the_champion_that_the_page_films(settings, analyses, scores):
    n_steps = settings.rollout.n_settle + settings.rollout.n_measure
    for environment in ("true_slush", "dry_land", "residual_slush", "single_member"):
        files = analyses[f"instruments/{environment}/1m"]
        best = max(
            (trial for e, _, trial in scores if e == environment),
            key=lambda trial: scores[environment, 1.0, trial].zero_shot,
        )
        champions = read_table(files, "champions")
        assert champions["trial"][champions["best"]].tolist() == [best]
        links, films = read_table(files, "links"), read_table(files, "films")
        expected = ["true_slush"] if environment == "true_slush" else ["true_slush", environment]
        assert films["seen_in"].tolist() == expected and set(films["trial"]) == {best}
        assert films["displacement"][0] == scores[environment, 1.0, best].zero_shot
        if environment == "single_member":
            assert films["member"].tolist() == [-1, best % settings.ensemble.n_members]
            assert films["displacement"][1] == scores[environment, 1.0, best].predicted
        for seen_in, mean, novel in rows(films, "seen_in", "disagreement", "share_novel"):
            of = links["seen_in"] == seen_in
            assert links["step"][of].tolist() == [step for step in range(n_steps) for _ in range(6)]
            assert links["link"][of].tolist() == [*range(6)] * n_steps
            assert links["disagreement"][of].mean(dtype=np.float64) == pytest.approx(mean, rel=1e-6)
            assert np.mean(links["novelty"][of] > 1) == pytest.approx(novel)
        assert set(links["component"]) <= set(SPACE) and len(set(links["component"])) > 1
        assert read_reasons(files) == {}


def test_a_planted_exploiter_is_ranked_first(settings, study):
    """One assessed design is made to fail where every member says that it gets far."""
    store, upstream = study
    item = specified(ANALYSE, settings, upstream, "exploiters")
    inputs = inputs_of(store, item)
    share = InputName(ASSESSED, AssessmentId(TrialId("assess", "dry_land", 1.0, 1), DataSetId("throws", 0)))
    table = read_predictions([inputs[share]])
    table["predicted"][2] = 900.0
    inputs[share] = {PREDICTIONS: encode_table(table, schema="predictions", version=1, producer="planted")}
    ranked = read_table(ANALYSE.compute(item.job, inputs), "exploiters")
    assert (ranked["rank"][0], ranked["kind"][0], ranked["ranked_by"][0]) == (1, "assessed", "excess")
    assert (ranked["trial"][0], ranked["identity"][0]) == (1, table["identity"][2])
    assert ranked["excess"][0] == 900.0 - table["true"][2] and ranked["disagreement"][0] == 0
    assert len(ranked["rank"]) == 21 + 8


def test_one_depth_and_few_trials_say_what_they_cannot_show(analyses):
    assert read_reasons(analyses["transfer-matrix"]) == {"matrix": "a single depth: the matrix has one column"}
    paper = read_table(analyses["statistics"], "paper")
    assert len(paper["what"]) == 40 and all(paper["why"])
    assert not (paper["verdict"][np.char.find(paper["what"], "at 9 m") >= 0] == "agrees").any()
    means = read_table(analyses["statistics"], "contrasts")
    assert (means["a_n"] == 2).all() and all("expected 3" in why or "needs 3" in why for why in means["ratio_reason"])


def test_a_study_without_networks_gets_what_needs_none(settings, study):
    """Its trials are the study's own, so the store holds them; only the analysis is new."""
    store, upstream = study
    grid = settings.grid.model_copy(update={"environments": ("true_slush", "dry_land"), "single_member_depths": ()})
    without = Settings.model_validate(settings.model_copy(update={"grid": grid}).model_dump())
    assert not without.needs_ensemble and ASSESS.plan(without) == []
    upstream = {**upstream, **{name: type(upstream[name])(name, {}) for name in ("collect", "train", "assess")}}
    why = "no trial of this study needs networks"
    for chain in ANALYSE.plan(without):
        item = ANALYSE.item(without, chain, 0, None, upstream)
        files = ANALYSE.compute(item.job, inputs_of(store, item))
        reasons = read_reasons(files)
        for name in files:
            if name.endswith(".parquet"):
                table = read_table(files, name.removesuffix(".parquet"))
                has_rows = len(next(iter(table.values()))) > 0
                assert has_rows or reasons[name.removesuffix(".parquet")].startswith(why)
        if chain.label.startswith("instruments"):
            assert set(reasons) == {"champion_coverage", "links", "films", "member_errors"}
            assert np.isfinite(read_table(files, "champions")["loss"]).all()
        if chain.label == "statistics":
            assert set(reasons) == {"regressions", "histograms", "contrasts"}


def test_failed_trials_are_named_and_the_rest_is_there(settings, study):
    store, upstream = study
    lost = [TrialId("transfer", "dry_land", 1.0, trial) for trial in range(2)]
    found = upstream["transfer"]
    done = {trial: chain for trial, chain in found.done.items() if trial not in lost}
    cut = type(found)("transfer", done, dict.fromkeys(lost, "failed: no such luck"))
    no_member = type(found)("train", {}, {NetworkId(DataSetId("throws", 0), 0): "failed: it burst"})
    upstream = {**upstream, "transfer": cut, "train": no_member}
    statistics = specified(ANALYSE, settings, upstream, "statistics")
    files = ANALYSE.compute(statistics.job, inputs_of(store, statistics))
    table = read_table(files, "scores")
    status = dict(zip(rows(table, "environment", "trial"), table["status"].tolist(), strict=True))
    assert status["dry_land", 1] == "failed: no such luck" and status["true_slush", 1] == "ok"
    assert "Dry Land zero-shot against True Slush" in read_reasons(files)["contrasts"]
    arm = specified(ANALYSE, settings, upstream, "instruments/dry_land/1m")
    assert set(read_reasons(ANALYSE.compute(arm.job, inputs_of(store, arm))).values()) == {
        "no trial of this arm has a champion"
    }
    arm = specified(ANALYSE, settings, upstream, "instruments/residual_slush/1m")
    files = ANALYSE.compute(arm.job, inputs_of(store, arm))
    assert "it burst" in read_reasons(files)["links"]
    assert np.isfinite(read_table(files, "champions")["slush_displacement"]).all()
    assert all("it burst" in why for why in read_table(files, "champions")["loss_reason"])


def test_champions_that_diverge_in_true_slush_are_shown_where_they_evolved(settings, study):
    store, upstream = study
    item = specified(ANALYSE, settings, upstream, "instruments/residual_slush/1m")
    inputs = inputs_of(store, item)
    for name in [name for name in inputs if name.role == SCORED]:
        scores = decode_json(inputs[name][SCORE], name.label) | {"zero_shot": None, "zero_shot_com": None}
        inputs[name] = {**inputs[name], SCORE: encode_json(scores)}
    files = ANALYSE.compute(item.job, inputs)
    champions, films = read_table(files, "champions"), read_table(files, "films")
    assert films["seen_in"].tolist() == ["residual_slush"] and len(read_table(files, "links")["step"]) == 25 * 6
    assert champions["best"].tolist() == (champions["claimed"] == champions["claimed"].max()).tolist()
    assert "stays finite in True Slush" in read_reasons(files)["films"]


def test_trials_whose_designs_all_diverged_leave_tables_that_say_so(settings, study):
    store, upstream = study
    status = "no champion: every design of the trial diverged"
    for chain in ANALYSE.plan(settings):
        item = ANALYSE.item(settings, chain, 0, None, upstream)
        inputs = inputs_of(store, item)
        none = {name: {SCORE: encode_json({"status": status})} for name in inputs if name.role == SCORED}
        files = ANALYSE.compute(item.job, inputs | none)
        if chain.label == "statistics":
            assert set(read_table(files, "scores")["status"]) == {status}
            assert len(read_table(files, "contrasts")["a"]) == 0 and "contrasts" in read_reasons(files)
            assert not any(np.isfinite(read_table(files, "attribution")["gap"]))
        if chain.label == "exploiters":
            assert set(read_table(files, "exploiters")["kind"]) == {"assessed"}
        if chain.label.startswith(("instruments", "transfer-matrix")):
            assert set(read_reasons(files)) == {n.removesuffix(".parquet") for n in files} - {"reasons.json"}


def test_the_assessed_depth_is_the_papers_or_the_deepest():
    def depth_of(text):
        return parse(Settings, text, name="s").assessed_depth

    assert depth_of("name: s") == 9
    assert depth_of("name: s\ngrid: {depths: [2.0, 0.5]}") == 2
    assert depth_of("name: s\ngrid: {depths: [2.0, 0.5]}\nassess: {depth: 0.5}") == 0.5


def test_summary_gives_every_table_to_read_and_the_metrics_by_which_studies_are_compared(settings, study):
    store, upstream = study
    summary = ANALYSE.summarise(settings, upstream["analyse"], store)
    assert summary.of_study
    assert {"statistics/paper.csv", "members/phantom_thrust.csv", "exploiters/exploiters.csv"} <= set(summary.artifacts)
    assert not any("links" in name for name in summary.artifacts)
    metrics = (
        "ratio_to_true_slush.zero_shot.residual_slush.1m",
        "accuracy.r.mean",
        "accuracy.slope.mean_less_1_sd",
        "phantom_thrust.member-1",
        "phantom_thrust.rms",
        "hallucinated.worst_champion",
    )
    assert set(metrics) <= set(summary.metrics)
    assert any("True Slush at 9 m" in line and "not comparable" in line for line in summary.lines)
    assert max(map(len, summary.lines)) <= 78  # the terminal indents them by two
    assert not any("between replicates" in line for line in summary.lines)  # there is one
    assert any(line.startswith(" " * 30) and "paper         this run (95 %)" in line for line in summary.lines)
