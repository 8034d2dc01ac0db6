"""A kit's files, read back by other libraries."""

import csv
import io
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from build123d import import_step

from pipeline.bench.fabrication.exports import exports

ROOT = Path(__file__).parents[4]
MESHED = 2e-3  # relative tolerance: facets miss curved faces by up to 0.05 mm, also in 3 mm holes


@pytest.fixture(scope="module")
def files(kit):
    return exports(kit, title="Crane")


def test_stl_is_watertight_lies_on_the_bed_and_has_the_part_s_volume(kit, files):
    for printed in (*kit.parts, *kit.gauges):
        content = files[f"print/{printed.name}.stl"]
        facets = np.frombuffer(content, np.dtype([("n", "<f4", 3), ("p", "<f4", (3, 3)), ("", "<u2")]), offset=84)
        sides = np.diff(facets["p"], axis=1)
        outward = (np.cross(sides[:, 0], sides[:, 1]) * facets["n"]).sum(axis=1)  # right-handed around each normal
        assert (outward > 0).mean() > 0.99
        mesh = trimesh.load(io.BytesIO(content), file_type="stl")
        assert mesh.is_watertight and mesh.is_winding_consistent and mesh.body_count == 1
        assert mesh.volume == pytest.approx(printed.solid.volume, rel=MESHED)
        assert np.allclose(mesh.bounds[0], 0.0, atol=1e-4) and mesh.bounds[1][2] < 25.001


def test_step_keeps_volume_and_place(kit, files, tmp_path):
    for part in kit.parts:
        path = tmp_path / f"{part.name}.step"
        path.write_bytes(files[f"cad/{part.name}.step"])
        (solid,) = import_step(path).solids()
        assert solid.is_valid and solid.volume == pytest.approx(part.solid.volume, rel=1e-6)
        assert np.allclose(tuple(solid.center()), tuple(part.solid.center()), atol=1e-4)
    (tmp_path / "robot.step").write_bytes(files["robot.step"])
    solids = import_step(tmp_path / "robot.step").solids()
    assert len(solids) == len(kit.parts) + len(kit.bought)
    expected = sum(thing.solid.volume for thing in (*kit.parts, *kit.bought))
    assert sum(s.volume for s in solids) == pytest.approx(expected, rel=1e-6)
    for name in ("part-1-left", "servo of joint 2, left", "rod 1 of part 2"):
        assert name.encode() in files["robot.step"]


def test_the_bill_as_csv(kit, files):
    rows = list(csv.DictReader(io.StringIO(files["bill.csv"].decode())))
    assert {row["kind"] for row in rows} == {"print", "servo", "screw", "rod", "pin", "supplies", "electronics"}
    rods = sum(int(row["count"]) for row in rows if row["kind"] == "rod")
    assert rods == sum(map(len, kit.layers.rods))
    assert sum(float(row["all_mass_g"] or 0) for row in rows) == pytest.approx(kit.mass_g, abs=0.05 * len(rows))


def text_of(drawing: bytes) -> str:
    """Return the text of a drawing as SVG."""
    elements = ElementTree.fromstring(drawing).iter()
    return " ".join("".join(element.itertext()) for element in elements if element.tag.endswith("text"))


def test_the_drawing_shows_joints_angles_and_dimensions(kit, files):
    text = text_of(files["drawing.svg"])
    for said in ("Crane", "joint 2", "joint 4", "part 1", "part 3", "±28.6°", "±45.8°", "R1.1", "300 apart"):
        assert said in text, said
    bounds = np.array([outline.bounds for outline in kit.outlines])
    for extent in bounds.max(axis=0)[2:] - bounds.min(axis=0)[:2]:
        assert f"{extent:.1f}" in text
    assert b"/MediaBox [ 0 0 1190.55" in files["drawing.pdf"]  # 420 mm
    assert len(ElementTree.fromstring(files["robot.svg"]).findall(".//{*}path")) > 100


def test_cad_is_imported_late_and_its_absence_is_one_clear_message():
    code = (
        "import sys\nimport pipeline.commands.app\nimport pipeline.bench.fabrication.make_kit as make_kit\n"
        "assert not {'build123d', 'shapely'} & sys.modules.keys()\n"
        "make_kit.find_spec = lambda name: None if name == 'build123d' else name\nmake_kit.require_cad()"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 1
    assert "PuddleError: build123d not installed" in done.stderr and "`make setup EXTRAS=cad`" in done.stderr
