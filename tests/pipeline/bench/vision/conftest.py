"""A small tank on video: two throws into the slush and the board, in a second or two."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import yaml

from pipeline.bench.vision.markers_file import markers_of
from tasks.bench.fabrication.kit_settings import KitSettings, ThrowingKit
from tasks.bench.fabrication.throwing_bars import throwing_bars
from tasks.residual.throws import Starts
from tasks.seeding import generator

if TYPE_CHECKING:
    from benchmarks.synthetic_tank import TankScene

STARTS = np.array([[0, 0.4, 0.4, 1.0, 0.5, 2.0], [0.3, -0.3, 2.0, -1.0, 1.0, -3.0], [0, 0.0, 1.0, 0.5, 0.0, 1.0]])


@dataclass(frozen=True)
class FilmedTank:
    """The files, and what is true of them."""

    folder: Path
    scene: TankScene
    truth: np.ndarray  # throw, time, x, y, angle, vx, vy, ω


@pytest.fixture(scope="session")
def tank(tmp_path_factory) -> FilmedTank:
    pytest.importorskip("cv2", reason="opencv-python-headless is not installed")
    from benchmarks.synthetic_tank import TankCamera, TankScene, film_board, render

    folder = tmp_path_factory.mktemp("tank")
    throwing = ThrowingKit(tank_length=0.4, tank_height=0.2, waterline=0.11)
    markers = markers_of(throwing, throwing_bars(throwing, KitSettings(), 1000.0))
    camera = TankCamera(width=640, height=368, field=0.5, distance=0.7, drop=0.1)
    scene = TankScene(camera, markers, rng=generator(1, "tank"))
    starts = Starts(np.arange(3), np.array([1.0, 1.5, 1.0]), STARTS.astype(np.float32))
    truth = np.array(render(folder / "throws.mp4", scene, starts, [0, 1, 0], 0.25))
    film_board(folder / "board.mp4", camera, markers, 8, generator(2, "board"))
    (folder / "markers.yaml").write_text(yaml.safe_dump(markers.model_dump(mode="json")))
    return FilmedTank(folder, scene, truth)
