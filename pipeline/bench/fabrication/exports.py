"""A kit's files for printing, buying, assembly and other CAD programs. The same kit gives the same bytes.

::

    robot.svg  drawing.svg  drawing.pdf  bill.csv  robot.step
    print/PART.stl       one piece or gauge each, oriented for printing [mm]
    cad/PART.step        one piece each, in place in the robot
"""

import csv
import io
import re
from collections.abc import Sequence
from copy import copy
from itertools import count

import numpy as np
from build123d import Compound, Shape, export_step

from pipeline.bench.fabrication.assembly_drawing import assembly_drawing, perspective
from tasks.bench.fabrication.kit import Kit
from tasks.bench.fabrication.parts import Mesh, mesh_of, on_bed

_EPOCH = "1980-01-01T00:00:00"  # instead of the time of writing
_OCCURRENCE = re.compile(rb"(NEXT_ASSEMBLY_USAGE_OCCURRENCE)\('\d+'([^;]*;)")


def exports(kit: Kit, *, title: str) -> dict[str, bytes]:
    """Make a kit's files, by path inside its folder, with the drawing's title."""
    solids = [*((part.name, part.solid) for part in kit.parts), *((item.name, item.solid) for item in kit.bought)]
    robot = compound(solids, "robot")
    files = {"bill.csv": _bill_csv(kit), "robot.step": step(robot), "robot.svg": perspective(robot)}
    files |= {f"drawing.{form}": sheet for form, sheet in assembly_drawing(kit, robot, title).items()}
    for part in kit.parts:
        files[f"print/{part.name}.stl"] = stl(on_bed(part, mesh_of(part.solid)))
        files[f"cad/{part.name}.step"] = step(compound([(part.name, part.solid)], part.name))
    for gauge in kit.gauges:
        files[f"print/{gauge.name}.stl"] = stl(mesh_of(gauge.solid).on_bed())
    return files


def _bill_csv(kit: Kit) -> bytes:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("kind", "item", "count", "each_length_mm", "all_mass_g", "note"))
    for line in kit.bill:
        length = "" if line.length_mm is None else f"{line.length_mm:.1f}"
        mass = "" if line.mass_g is None else f"{line.mass_g:.1f}"
        rows.writerow((line.kind, line.item, line.count, length, mass, line.note))
    return text.getvalue().encode()


def compound(solids: Sequence[tuple[str, Shape]], label: str) -> Shape:
    """Join named solids into a labelled one."""
    children = []
    for name, solid in solids:
        named = copy(solid)
        named.label = name
        children.append(named)
    return children[0] if len(children) == 1 else Compound(label=label, children=children)


def step(shape: Shape) -> bytes:
    """Encode a shape as STEP AP214 with a fixed time stamp.

    The CAD kernel numbers the occurrences of parts throughout the process; here they count from 1.
    """
    buffer = io.BytesIO()
    export_step(shape, buffer, timestamp=_EPOCH)
    numbers = count(1)

    def renumbered(record: re.Match[bytes]) -> bytes:
        return b"%s('%d'%s" % (record[1], next(numbers), re.sub(rb"\n *", b"", record[2]))  # on one line of any length

    return _OCCURRENCE.sub(renumbered, buffer.getvalue())


def stl(mesh: Mesh) -> bytes:
    """Encode a mesh as binary STL [mm]."""
    corners = mesh.vertices[mesh.triangles].astype("<f4")
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facets = np.zeros(len(corners), dtype=record)
    facets["normal"], facets["corners"] = normals, corners
    return b"puddle".ljust(80, b"\0") + np.uint32(len(corners)).tobytes() + facets.tobytes()
