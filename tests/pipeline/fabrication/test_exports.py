"""A kit's files, read back by other libraries."""

import csv
import hashlib
import io
import json
import os
import subprocess
import sys
import warnings
import zipfile
from dataclasses import replace
from itertools import combinations
from math import pi
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import ezdxf
import lib3mf
import numpy as np
import pytest
import trimesh
from build123d import RectangleRounded, import_step
from PIL import Image
from shapely import LineString, Polygon, box, polygonize

from pipeline.fabrication import assembly_drawing
from pipeline.fabrication.exports import exports
from pipeline.fabrication.formats import dxf
from pipeline.fabrication.labels import Labels
from pipeline.store.design_file import design_document, read_design
from tasks.fabrication.kit import build_kit
from tasks.fabrication.kit_settings import KitSettings

MESHED = 2e-3
"""Relative tolerance: facets miss curved faces by up to 0.05 mm, also in 3 mm holes."""

MAKE = """
import hashlib, json, sys
import numpy as np
from pipeline.store.design_file import design_from
from pipeline.fabrication.exports import exports
from pipeline.fabrication.formats import dxf
from pipeline.fabrication.labels import Labels
from tasks.fabrication.kit import build_kit
from tasks.fabrication.kit_settings import KitSettings
design = design_from(json.load(sys.stdin), "standard input")
files = exports(build_kit(design, KitSettings()), title="Crane", n_faults=0)
from test_exports import profile_dxf
files["profile"] = profile_dxf()
print(json.dumps({name: hashlib.sha256(content).hexdigest() for name, content in files.items()}))
"""


def profile_dxf() -> bytes:
    """Return a DXF whose sets of names ezdxf orders by their hashes."""
    pocket = SimpleNamespace(circle=None, outline=box(-2, -2, 2, 2))
    bore = SimpleNamespace(circle=((5.0, 0.0), 1.5))
    return dxf(SimpleNamespace(face=RectangleRounded(60, 25, 5).face()), [pocket, bore], [pocket])


@pytest.fixture(scope="module")
def kit(crane):
    return build_kit(crane, KitSettings())


@pytest.fixture(scope="module")
def files(kit):
    return exports(kit, title="Crane", n_faults=0)


def test_every_part_has_its_files(kit, files):
    names = {part.name for part in kit.parts}
    assert names == {f"part-{n}-{side}" for n in (1, 2, 3) for side in ("left", "right")}
    printed = names | {"gauge-servo", "gauge-horn"}
    expected = {f"print/{name}.{form}" for name in printed for form in ("stl", "3mf")}
    expected |= {f"cad/{name}.step" for name in names} | {f"profiles/{name}.dxf" for name in names}
    expected |= {"robot.png", "robot.step", "bill.csv", "drawing.svg", "drawing.pdf", "drawing.png"}
    assert set(files) == expected


def test_stl_is_watertight_and_has_the_part_s_volume(kit, files):
    for part in kit.parts:
        mesh = trimesh.load(io.BytesIO(files[f"print/{part.name}.stl"]), file_type="stl")
        assert mesh.is_watertight and mesh.is_winding_consistent and mesh.body_count == 1
        assert mesh.volume == pytest.approx(part.volume_mm3, rel=MESHED)
        assert np.allclose(mesh.bounds[0], 0.0, atol=1e-4) and mesh.bounds[1][2] == pytest.approx(25.0)


def test_gauges_are_watertight_and_lie_on_the_bed(kit, files):
    for gauge in kit.gauges:
        mesh = trimesh.load(io.BytesIO(files[f"print/{gauge.name}.stl"]), file_type="stl")
        assert mesh.is_watertight and mesh.is_winding_consistent and mesh.body_count == 1
        assert mesh.volume == pytest.approx(gauge.volume_mm3, rel=MESHED)
        assert np.allclose(mesh.bounds[0], 0.0, atol=1e-4)


def test_3mf_is_what_its_own_library_reads(kit, files):
    wrapper = lib3mf.Wrapper()
    for part in kit.parts:
        content = files[f"print/{part.name}.3mf"]
        assert zipfile.ZipFile(io.BytesIO(content)).testzip() is None
        model = wrapper.CreateModel()
        reader = model.QueryReader("3mf")
        reader.SetStrictModeActive(True)
        reader.ReadFromBuffer(bytearray(content))
        assert reader.GetWarningCount() == 0 and model.GetUnit() == lib3mf.ModelUnit.MilliMeter
        objects = model.GetMeshObjects()
        assert objects.MoveNext()
        mesh = objects.GetCurrentMeshObject()
        assert mesh.GetName() == part.name and mesh.IsManifoldAndOriented()
        read = trimesh.Trimesh(
            [list(v.Coordinates) for v in mesh.GetVertices()], [list(t.Indices) for t in mesh.GetTriangleIndices()]
        )
        assert read.is_watertight and read.volume == pytest.approx(part.volume_mm3, rel=MESHED)
        assert not objects.MoveNext() and model.GetBuildItems().MoveNext()


def test_step_keeps_volume_and_place(kit, files, tmp_path):
    for part in kit.parts:
        path = tmp_path / f"{part.name}.step"
        path.write_bytes(files[f"cad/{part.name}.step"])
        read = import_step(path)
        (solid,) = read.solids()
        assert solid.is_valid and solid.volume == pytest.approx(part.volume_mm3, rel=1e-6)
        assert np.allclose(tuple(solid.center()), tuple(part.solid.center()), atol=1e-4)


def test_the_whole_robot_as_step(kit, files, tmp_path):
    path = tmp_path / "robot.step"
    path.write_bytes(files["robot.step"])
    solids = import_step(path).solids()
    assert len(solids) == len(kit.parts) + len(kit.bought)
    expected = sum(p.volume_mm3 for p in kit.parts) + sum(b.solid.volume for b in kit.bought)
    assert sum(s.volume for s in solids) == pytest.approx(expected, rel=1e-6)
    for name in ("part-1-left", "servo of joint 2, left", "rod 1 of part 2"):
        assert name.encode() in files["robot.step"]


def test_dxf_has_the_outline_and_every_bore(kit, files):
    for (body, side), features in kit.features.items():
        document = ezdxf.read(io.StringIO(files[f"profiles/part-{body + 1}-{side}.dxf"].decode()))
        assert document.units == ezdxf.units.MM and not document.audit().errors
        space = document.modelspace()
        chains = []
        for entity in space.query('*[layer=="OUTLINE"]'):
            if entity.dxftype() == "LINE":
                chains.append([entity.dxf.start, entity.dxf.end])
            else:
                chains.append(list(entity.flattening(0.001)))
        lines = [[(round(p.x, 5), round(p.y, 5)) for p in chain] for chain in chains]
        (outline,) = polygonize([LineString(line) for line in lines]).geoms
        assert outline.area == pytest.approx(kit.profiles[body].face.area, rel=1e-4)
        circles = sorted((c.dxf.center.x, c.dxf.center.y, c.dxf.radius) for c in space.query('CIRCLE[layer=="BORES"]'))
        expected = sorted((*f.circle[0], f.circle[1]) for f in features if f.circle)
        assert np.allclose(circles, expected)
        pockets = [Polygon(p.get_points("xy")).area for p in space.query('LWPOLYLINE[layer=="POCKETS"]')]
        assert sorted(pockets) == pytest.approx(sorted(f.outline.area for f in features if not f.circle))


def test_the_bill_as_csv(kit, files):
    rows = list(csv.DictReader(io.StringIO(files["bill.csv"].decode())))
    assert {row["kind"] for row in rows} == {"print", "servo", "screw", "rod", "pin", "supplies", "electronics"}
    rods = [row for row in rows if row["kind"] == "rod"]
    for row in rods:
        grams = int(row["count"]) * float(row["each_length_mm"]) * pi * 1.5**2 * 7.9e-3
        assert float(row["all_mass_g"]) == pytest.approx(grams, abs=0.051)
    assert sum(int(row["count"]) for row in rods) == sum(map(len, kit.layers.rods))
    assert sum(float(row["all_mass_g"] or 0) for row in rows) == pytest.approx(kit.mass_g, abs=0.05 * len(rows))


def text_of(drawing: bytes) -> str:
    """Return the text of a drawing as SVG."""
    elements = ElementTree.fromstring(drawing).iter()
    return " ".join("".join(element.itertext()) for element in elements if element.tag.endswith("text"))


def test_the_drawing_shows_joints_angles_and_dimensions(kit, files):
    text = text_of(files["drawing.svg"])
    for said in ("Crane", "joint 2", "joint 4", "part 1", "part 3", "±28.6°", "±45.8°", "R1.1", "300", "325.0", "99.0"):
        assert said in text, said
    bounds = np.array([profile.polygon.bounds for profile in kit.profiles])
    for extent in bounds.max(axis=0)[2:] - bounds.min(axis=0)[:2]:
        assert f"{extent:.1f}" in text
    assert files["drawing.pdf"].startswith(b"%PDF-") and b"CreationDate" not in files["drawing.pdf"]
    assert b"/MediaBox [ 0 0 1190.55" in files["drawing.pdf"]  # 420 mm


def drawn(kit, monkeypatch, n_faults: int = 0) -> tuple[str, list[Labels]]:
    """Draw a kit; return its text and the labels of each view."""
    views = []

    class Recorded(Labels):
        def __init__(self, sheet):
            super().__init__(sheet)
            views.append(self)

    monkeypatch.setattr(assembly_drawing, "Labels", Recorded)
    return text_of(assembly_drawing.assembly_drawing(kit, "Drawn", n_faults)["svg"]), views


def test_joints_on_one_axis_have_no_distance_to_draw(kit, monkeypatch):
    first, second = kit.servo_joints
    moved = replace(second, joint=replace(second.joint, at=(first.joint.at[0] + 1e-14, first.joint.at[1])))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        text, _ = drawn(replace(kit, servo_joints=(first, moved)), monkeypatch)
    assert " 0.0 " not in text and "joint 2" in text and "joint 4" in text


def test_a_drawing_states_the_number_of_faults_and_no_label_lies_on_another(kit, files, monkeypatch):
    assert "fault" not in text_of(files["drawing.svg"])
    crowded = build_kit(read_design(Path(__file__).parents[3] / "docs/design.json"), KitSettings())  # five parts
    for robot, n_faults, stated in ((kit, 1, "1 fault found"), (crowded, 11, "11 faults found")):
        text, views = drawn(robot, monkeypatch, n_faults)
        assert stated in text and len(views) == 2
        n_rods, n_joints = sum(map(len, robot.layers.rods)), len(robot.servo_joints)
        assert len(views[0].boxes) >= n_rods + n_joints + len(robot.mechanism.bodies) + 2
        for labels in views:
            for one, other in combinations(labels.boxes, 2):
                assert one.intersection(other).area < 0.05


def test_the_picture_shows_every_part(kit, files):
    image = Image.open(io.BytesIO(files["robot.png"])).convert("RGB")
    assert image.size == (1600, 1000)
    hues = np.array(image.crop((0, 0, 1600, 900)).convert("HSV")).reshape(-1, 3)
    coloured = hues[hues[:, 1] > 60]
    for hue in (20, 150, 71):  # orange, blue and green, of 255
        assert (np.abs(coloured[:, 0].astype(int) - hue) < 10).sum() > 5000, hue


def test_the_same_design_gives_the_same_bytes_in_another_process(crane, files):
    """Sets of strings have another order there, because that process has another hash seed."""
    paths = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    done = subprocess.run(
        [sys.executable, "-c", MAKE],
        input=json.dumps(design_document(crane)),
        text=True,
        capture_output=True,
        env={**os.environ, "PYTHONHASHSEED": "5", "PYTHONPATH": paths},
        check=True,
    )
    here = {name: hashlib.sha256(content).hexdigest() for name, content in {**files, "profile": profile_dxf()}.items()}
    there = json.loads(done.stdout)
    assert {name for name in here if here[name] != there.get(name)} == set() and here.keys() == there.keys()


def test_cad_is_imported_late_and_its_absence_is_one_clear_message():
    code = (
        "import sys\nimport pipeline.commands.app\nfrom pipeline.fabrication.make_kit import require_cad\n"
        "assert not {'build123d', 'shapely', 'ezdxf'} & sys.modules.keys()\n"
        "from importlib import util\nfound = util.find_spec\n"
        "import pipeline.fabrication.make_kit as make_kit\n"
        "make_kit.find_spec = lambda name: None if name == 'build123d' else found(name)\nrequire_cad()"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=Path(__file__).parents[3], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].endswith(
        "PuddleError: build123d not installed, but needed to make parts. Run `make setup EXTRAS=cad` in the checkout; "
        "without a checkout, `pip install 'puddle[cad]'`."
    )
