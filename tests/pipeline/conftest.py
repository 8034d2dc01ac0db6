"""What tests of the pipeline share: studies as small as can be, with every stage done; an empty store; a browser."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from browser import CHROMIUM, Browser
from command_line import WITHOUT_MLFLOW, call
from small_study import ON_DRY_LAND, run, silent, tiny

from pipeline.cluster import serial_cluster
from pipeline.config.settings import Settings
from pipeline.report import page
from pipeline.report.study_page import FIGURES
from pipeline.store.store import Store
from pipeline.workflow.record import DrivenStudy


@pytest.fixture(scope="session", autouse=True)
def few_figures() -> Iterator[None]:
    """Spare studies the drawing of all figures, which takes seconds, but where a test asks for ``all_figures``."""
    with pytest.MonkeyPatch.context() as patch:
        kept = ("transfer_at_depth", "fitness_curves", "elites")
        patch.setattr(page, "FIGURES", {name: FIGURES[name] for name in kept})
        yield


@pytest.fixture
def all_figures(monkeypatch) -> None:
    monkeypatch.setattr(page, "FIGURES", FIGURES)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store.open(tmp_path / "store", create=True)


@pytest.fixture(scope="session")
def settings() -> Settings:
    return tiny()


@pytest.fixture(scope="session")
def study(settings, tmp_path_factory):
    """A store with every stage done, and the results of each."""
    store = Store.open(tmp_path_factory.mktemp("stages") / "store", create=True)
    with serial_cluster() as cluster:
        return store, run(settings, store, cluster)


@pytest.fixture(scope="session")
def recorded(settings, study, tmp_path_factory) -> Path:
    """A store like that of ``study``, with the study's record. Tests that change it change a copy."""
    store, results = study
    root = tmp_path_factory.mktemp("recorded") / "store"
    shutil.copytree(store.root, root)
    DrivenStudy(settings, Store.open(root, create=False), silent).update(results)
    return root


@pytest.fixture(scope="session")
def done(tmp_path_factory) -> Path:
    """A folder with a settings file, and a store with its study: what commands work on."""
    folder = tmp_path_factory.mktemp("done")
    (folder / "tiny.yaml").write_text(ON_DRY_LAND)
    options = ["--settings", str(folder / "tiny.yaml"), "--store", str(folder / "store")]
    assert call("study", "--workers", "0", *options, *WITHOUT_MLFLOW) == 0
    return folder


@pytest.fixture
def options(done, tmp_path) -> list[str]:
    """Options for a copy of it."""
    shutil.copytree(done, tmp_path, dirs_exist_ok=True)
    return ["--settings", str(tmp_path / "tiny.yaml"), "--store", str(tmp_path / "store")]


@pytest.fixture(scope="session")
def browser(tmp_path_factory) -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed")
    started = Browser(tmp_path_factory.mktemp("profile"))
    yield started
    started.close()


class SteppedClock:
    """A clock that only ``sleep`` advances, so that a run is fast and never late on a busy machine."""

    def __init__(self) -> None:
        self.time = 100.0

    def now(self) -> float:
        return self.time

    def sleep(self, duration: float) -> None:
        self.time += duration


@pytest.fixture
def clock() -> SteppedClock:
    return SteppedClock()
