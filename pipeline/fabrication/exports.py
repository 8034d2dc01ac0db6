"""A kit's files for printing, buying, assembly and other CAD programs. The same kit gives the same bytes.

::

    robot.png  drawing.svg  drawing.pdf  drawing.png  bill.csv  robot.step
    print/PART.stl  print/PART.3mf      one piece or gauge each, oriented for printing
    cad/PART.step                       one piece each, in place in the robot
    profiles/PART.dxf                   outline, bores and pockets of one copy of a part
"""

import csv
import io

from PIL import ImageColor

from pipeline.fabrication.assembly_drawing import PART_COLOURS, assembly_drawing
from pipeline.fabrication.formats import dxf, step, stl, three_mf
from pipeline.fabrication.picture import Colour, picture
from tasks.fabrication.features import Feature
from tasks.fabrication.kit import Kit
from tasks.fabrication.parts import Mesh, mesh_of, on_bed

_BOUGHT_COLOURS: dict[str, Colour] = {
    "servo": (62, 62, 70),
    "horn": (214, 188, 96),
    "rod": (196, 200, 206),
    "pin": (196, 200, 206),
}


def exports(kit: Kit, *, title: str, n_faults: int) -> dict[str, bytes]:
    """Make a kit's files, by name.

    Args:
        kit: The kit.
        title: Title of the drawing.
        n_faults: Number of faults, for the drawing's warning.

    Returns:
        Contents by path inside the kit's folder.
    """
    meshes = [mesh_of(part.solid) for part in kit.parts]
    files = {"robot.png": _picture(kit, meshes), "bill.csv": _bill_csv(kit)}
    files |= {f"drawing.{form}": content for form, content in assembly_drawing(kit, title, n_faults).items()}
    everything = [(part.name, part.solid) for part in kit.parts] + [(item.name, item.solid) for item in kit.bought]
    files["robot.step"] = step(everything, "robot")
    for part, mesh in zip(kit.parts, meshes, strict=True):
        lying = on_bed(part, mesh)
        files[f"print/{part.name}.stl"] = stl(lying)
        files[f"print/{part.name}.3mf"] = three_mf([(part.name, lying)])
        files[f"cad/{part.name}.step"] = step([(part.name, part.solid)], part.name)
    for gauge in kit.gauges:
        mesh = mesh_of(gauge.solid)
        mesh = Mesh(mesh.vertices - mesh.vertices.min(axis=0), mesh.triangles)
        files[f"print/{gauge.name}.stl"] = stl(mesh)
        files[f"print/{gauge.name}.3mf"] = three_mf([(gauge.name, mesh)])
    for (body, side), features in kit.features.items():
        cuts = [Feature("cut", "cut", cut, 0.0, kit.settings.thickness_mm) for cut in kit.splits[body].cuts]
        files[f"profiles/part-{body + 1}-{side}.dxf"] = dxf(kit.profiles[body], features, cuts)
    return files


def _bill_csv(kit: Kit) -> bytes:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["kind", "item", "count", "each_length_mm", "all_mass_g", "note"])
    for line in kit.bill:
        length = "" if line.length_mm is None else f"{line.length_mm:.1f}"
        mass = "" if line.mass_g is None else f"{line.mass_g:.1f}"
        rows.writerow([line.kind, line.item, line.count, length, mass, line.note])
    return text.getvalue().encode()


def _picture(kit: Kit, meshes: list[Mesh]) -> bytes:
    parts: list[Colour] = [ImageColor.getrgb(colour)[:3] for colour in PART_COLOURS]
    shown = [(mesh, parts[part.body % len(parts)]) for part, mesh in zip(kit.parts, meshes, strict=True)]
    shown += [(mesh_of(item.solid), _BOUGHT_COLOURS[item.kind]) for item in kit.bought]
    kinds = dict.fromkeys(item.kind for item in kit.bought if item.kind in ("servo", "rod"))
    legend = [(body.name, parts[body.index % len(parts)]) for body in kit.mechanism.bodies]
    return picture(shown, [*legend, *((kind, _BOUGHT_COLOURS[kind]) for kind in kinds)])
