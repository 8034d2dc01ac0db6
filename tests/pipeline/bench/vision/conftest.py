"""A small tank on video: two throws into the slush and the board, in a second or two."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import yaml

from tasks.bench.fabrication.kit_settings import ThrowingKit
from tasks.residual.throws import Starts
from tasks.seeding import generator

if TYPE_CHECKING:
    from synthetic_tank import TankScene

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
    from synthetic_tank import TankCamera, TankScene, film_board, film_throws, markers_of_tank

    folder = tmp_path_factory.mktemp("tank")
    markers = markers_of_tank(ThrowingKit(tank_length=0.4, tank_height=0.2, waterline=0.11))
    camera = TankCamera(width=640, height=368, field=0.5, distance=0.7, drop=0.1)
    scene = TankScene(camera, markers, rng=generator(1, "tank"))
    starts = Starts(np.arange(3), np.array([1.0, 1.5, 1.0]), STARTS.astype(np.float32))
    truth = film_throws(folder / "throws.mp4", scene, starts, [0, 1, 0], 0.25)
    film_board(folder / "board.mp4", camera, markers, 8, generator(2, "board"))
    (folder / "markers.yaml").write_text(yaml.safe_dump(markers.model_dump(mode="json")))
    return FilmedTank(folder, scene, truth)
