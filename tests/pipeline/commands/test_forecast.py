"""A forecast measures where the study is to be, and leaves nothing there; generations are priced as they come."""

import os
import signal
import tempfile
import time
from pathlib import Path

import pytest
from numpy.random import default_rng

from pipeline.commands.app import main
from pipeline.commands.cost_model import forecast_lines
from pipeline.commands.rates import Rates, seconds_of_a_result, time_of_selection
from pipeline.commands.sizes import BYTES_OF_A_DESIGN
from pipeline.config.loading import load, preset_path
from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.store.store import Store
from tasks.design import random_designs
from tasks.evolution import EMPTY_POPULATION, ask


@pytest.fixture(scope="module")
def smoke() -> Settings:
    return load(Settings, preset_path("smoke"), ())


@pytest.fixture
def elsewhere(tmp_path, monkeypatch) -> Path:
    """Where a store is to be, on a disk that is not the one of temporary files."""
    monkeypatch.setattr(tempfile, "tempdir", "/dev")
    folder = tmp_path / "disk"
    folder.mkdir()
    return folder


@pytest.fixture
def opened(monkeypatch) -> list[Path]:
    """Where stores are opened."""
    places = []
    plain = Store.open
    monkeypatch.setattr(Store, "open", lambda root, *, create: (places.append(root), plain(root, create=create))[1])
    return places


def test_the_disk_is_timed_where_the_store_is_to_be_and_nothing_is_left(smoke, elsewhere, opened):
    assert 0 < seconds_of_a_result(smoke, elsewhere / "not" / "yet" / "made") < 10
    assert len(opened) == 1 and opened[0].is_relative_to(elsewhere)
    assert list(elsewhere.iterdir()) == []


def test_temporary_files_are_the_systems_where_they_lie_on_the_same_disk(smoke, tmp_path, monkeypatch, opened):
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    seconds_of_a_result(smoke, tmp_path / "store")
    assert len(opened) == 1 and opened[0].is_relative_to(tmp_path / "temporary")
    assert not (tmp_path / "store").exists()


def test_a_disk_that_keeps_nothing_is_an_error_that_says_so(smoke, elsewhere):
    (elsewhere / "file").write_text("no folder")
    why = f"{elsewhere}/file/store: timing what a result costs failed: Not a directory"
    with pytest.raises(PuddleError, match=why):
        seconds_of_a_result(smoke, elsewhere / "file" / "store")


def test_no_more_is_kept_for_the_time_it_takes_than_a_trial_keeps(elsewhere, monkeypatch):
    kept = []
    plain = Store.commit

    def commit(store, stage, key, identity, files, *, record):
        kept.append(len(files["history.parquet"]))
        return plain(store, stage, key, identity, files, record=record)

    monkeypatch.setattr(Store, "commit", commit)
    overrides = ("evolution.n_generations=5", "work.generations_per_item=5000")
    settings = load(Settings, preset_path("smoke"), overrides)
    seconds_of_a_result(settings, elsewhere / "store")
    assert set(kept) == {5 * settings.evolution.afpo.population_size * BYTES_OF_A_DESIGN}


def test_a_signal_leaves_nothing(smoke, elsewhere, monkeypatch):
    monkeypatch.setattr(Store, "commit", lambda *arguments, **options: os.kill(os.getpid(), signal.SIGTERM))
    with pytest.raises(SystemExit):
        seconds_of_a_result(smoke, elsewhere / "store")
    assert list(elsewhere.iterdir()) == []


@pytest.fixture
def measured(monkeypatch) -> None:
    """Rates are these, whatever the machine."""
    rates = Rates(
        throw=0.01,
        iteration=0.01,
        population_size=8,
        picture=0.02,
        look=0.2,
        simulation=dict.fromkeys(("true_slush", "dry_land", "residual_slush", "single_member"), 0.01),
        selection={"evolve": 0.002, "transfer": 0.001},
    )
    monkeypatch.setattr("pipeline.commands.cost_model.measure", lambda settings, say: rates)


def test_what_a_result_costs_is_asked_for_other_cores_alone(measured, smoke, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(
        "pipeline.commands.cost_model.seconds_of_a_result", lambda settings, root: asked.append(root) or 0.01
    )
    forecast_lines(smoke, tmp_path / "store", (), say=str)
    assert asked == []
    assert any("on 8 cores" in line for line in forecast_lines(smoke, tmp_path / "store", (8,), say=str))
    assert asked == [tmp_path / "store"]


def test_a_store_at_home_is_found(measured, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HOME", str(tmp_path))
    Store.open(Path("~/results"), create=True)
    for place, found in ("~/results", True), ("~/none", False):
        monkeypatch.setenv("PUDDLE_STORE", place)
        with pytest.raises(SystemExit) as ended:
            main(["forecast", "--preset", "smoke"])
        assert not ended.value.code
        assert ("The store holds" in capsys.readouterr().out) == found


def test_a_generation_pays_for_its_own_draws_alone(monkeypatch):
    """Where links must be apart a body is drawn a thousand times: 64 bodies at first, then ten or so, none if given."""
    monkeypatch.setattr(time, "perf_counter", time.process_time)  # whatever else the machine does
    pontoon = load(Settings, preset_path("pontoon"), ())
    afpo, morphology = pontoon.evolution.afpo, pontoon.evolution.morphology
    start = time.process_time()
    ask(EMPTY_POPULATION, default_rng(0), afpo, morphology=morphology)
    first = time.process_time() - start
    later, adapting = (time_of_selection(pontoon, body) for body in (None, random_designs(1, default_rng(0))))
    assert first > 2 * later > 6 * adapting
