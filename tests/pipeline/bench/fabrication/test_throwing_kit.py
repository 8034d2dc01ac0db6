"""puddle fabricate --throwing-kit: a folder whose tags, printed and filmed, are where its markers file says."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from command_line import call
from PIL import Image

from pipeline.bench.fabrication.throwing_kit import starts_of
from pipeline.bench.vision.markers_file import Markers
from pipeline.config.loading import load
from tasks.bench.fabrication.kit_settings import KitSettings, ThrowingKit
from tasks.bench.fabrication.throwing_bars import throwing_bars


@pytest.fixture(scope="module")
def kit(tmp_path_factory):
    pytest.importorskip("cv2", reason="opencv-python-headless is not installed")
    folder = tmp_path_factory.mktemp("throwing") / "kit"
    assert call("fabricate", "--throwing-kit", "--out", str(folder)) == 0
    return folder


def test_every_file_is_there_and_every_link_leads_somewhere(kit):
    held = {str(path.relative_to(kit)) for path in kit.rglob("*") if path.is_file()}
    manifest = json.loads((kit / "throwing-kit.json").read_text())
    assert held == {*manifest["files"], "throwing-kit.json"}
    page = (kit / "index.html").read_text()
    links = set(re.findall(r"""(?:href|src)=["']([^"'#:]+)["']""", page))
    assert len(links) >= 8 and links <= held
    pdf = (kit / "tags.pdf").read_bytes()
    assert pdf.count(b"/Type /Page\n") == len(list(kit.glob("*.png"))) and b"/MediaBox [ 0 0 595.2" in pdf  # 210 mm


def test_throws_are_spread_over_what_bars_and_tank_allow():
    bars = throwing_bars(ThrowingKit(), KitSettings(), 1000.0)
    throws = starts_of(bars, 0.07, lowest=-0.15, highest=0.12)
    names, *numbers = zip(*throws, strict=True)
    heights, angles, speeds, *_ = np.array(numbers, dtype=float)
    size = {bar.name: np.array([bar.length_mm, bar.width_mm]) for bar in bars}
    turned = np.abs([np.cos(np.radians(angles)), np.sin(np.radians(angles))]).T
    reach = (np.array([size[name] for name in names]) * turned).sum(axis=1) / 2
    assert len(throws) == 64 and set(names) == {bar.name for bar in bars}
    # Whole bars are as far up and down as the tank's tags reach; heights are rounded to 1 mm, angles to 1°.
    assert -152 <= (heights - reach).min() < -140 and 110 < (heights + reach).max() <= 122
    assert 0.9 < speeds.max() < 1.6


@pytest.mark.parametrize("sheet", ["faces", "tags", "board"])
def test_printed_tags_have_the_size_that_the_markers_file_says(kit, sheet):
    from pipeline.bench.vision.tags import find_tags

    markers = load(Markers, kit / "markers.yaml")
    picture = Image.open(kit / f"{sheet}.png")
    assert picture.info["dpi"] == pytest.approx((300, 300), abs=0.01)
    per_mm = 300 / 25.4
    size = {tag.number: tag.size for bar in (*markers.bars, *markers.robot.bars()) for tag in bar.tags}
    size |= {tag.number: markers.tank.tag_size for tag in markers.tank.corners}
    seen = find_tags(markers, np.array(picture.convert("L")), sheet)
    expected = {
        "faces": {tag.number for bar in markers.bars for tag in bar.tags},
        "tags": {tag.number for tag in markers.tank.corners} | set(range(20, 26)),
        "board": set(),
    }
    assert seen.keys() == expected[sheet]
    for number, corners in seen.items():
        edges = np.linalg.norm(np.roll(corners, 1, axis=0) - corners, axis=1) / per_mm
        assert edges == pytest.approx(np.full(4, 1000 * size[number]), abs=0.2), number
    for bar in markers.bars if sheet == "faces" else ():
        up, down = (seen[tag.number].mean(axis=0) for tag in bar.tags)
        assert (down - up) / per_mm == pytest.approx((0, 1000 * (bar.tags[0].along - bar.tags[1].along)), abs=0.1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("docs/design.json",), "expected no design, --study or --preset"),
        (("--set", "throwing.waterline=0.3"), "throwing: "),
        (("--set", "throwing.lengths=[1,1.2,1.4,1.6,1.8,2,2.2,2.4,2.6]"), "throwing: tag 20 is on two things"),
        (("--set", "kit.rod_mm=6"), "bar-70: too heavy at any infill"),
        (("--set", "kit.scale_mm_per_m=200", "--set", "kit.rod_mm=10"), "does not fit on A4"),
    ],
)
def test_a_mistake_is_one_message_and_no_kit(tmp_path, options, message, capsys):
    pytest.importorskip("cv2", reason="opencv-python-headless is not installed")
    assert call("fabricate", "--throwing-kit", "--out", str(tmp_path / "kit"), *options) == 2
    said = capsys.readouterr().err
    assert message in said and not (tmp_path / "kit").exists()
