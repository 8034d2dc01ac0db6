"""STEP, STL, 3MF and DXF encodings. The same kit gives the same bytes."""

import io
import re
import zipfile
from collections.abc import Iterable, Sequence
from copy import copy
from itertools import count
from xml.sax.saxutils import quoteattr

import ezdxf
import numpy as np
from build123d import Compound, Edge, GeomType, Shape, export_step
from ezdxf.document import Drawing

from tasks.fabrication.features import Feature
from tasks.fabrication.parts import Mesh
from tasks.fabrication.profile import Profile

_EPOCH = "1980-01-01T00:00:00"  # instead of the time of writing
_OCCURRENCE = re.compile(rb"(NEXT_ASSEMBLY_USAGE_OCCURRENCE)\('\d+'([^;]*;)")
_ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)

_CONTENT_TYPES = """<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">
<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>
</Types>
"""
_RELATIONSHIPS = """<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Target="/3D/3dmodel.model" Id="rel0" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
</Relationships>
"""


def step(shapes: Sequence[tuple[str, Shape]], label: str) -> bytes:
    """Encode named solids as STEP AP214 with a fixed time stamp.

    The CAD kernel numbers the occurrences of parts throughout the process; here they count from 1.
    """
    children = []
    for name, shape in shapes:
        named = copy(shape)
        named.label = name
        children.append(named)
    whole: Shape = children[0] if len(children) == 1 else Compound(label=label, children=children)
    buffer = io.BytesIO()
    export_step(whole, buffer, timestamp=_EPOCH)
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


def three_mf(meshes: Sequence[tuple[str, Mesh]]) -> bytes:
    """Encode named meshes as 3MF [mm], a zip archive with one model."""
    objects = "".join(_object(number, name, mesh) for number, (name, mesh) in enumerate(meshes, 1))
    items = "".join(f'<item objectid="{number}"/>\n' for number in range(1, len(meshes) + 1))
    model = (
        '<?xml version="1.0" encoding="UTF-8"?>\n<model unit="millimeter" xml:lang="en-US" '
        'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">\n'
        f"<resources>\n{objects}</resources>\n<build>\n{items}</build>\n</model>\n"
    )
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, text in (
            ("[Content_Types].xml", _CONTENT_TYPES),
            ("_rels/.rels", _RELATIONSHIPS),
            ("3D/3dmodel.model", model),
        ):
            entry = zipfile.ZipInfo(name, _ZIP_EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, text)
    return buffer.getvalue()


def _object(number: int, name: str, mesh: Mesh) -> str:
    vertices = "".join(f'<vertex x="{x:.5f}" y="{y:.5f}" z="{z:.5f}"/>\n' for x, y, z in mesh.vertices.tolist())
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>\n' for a, b, c in mesh.triangles.tolist())
    return (
        f'<object id="{number}" type="model" name={quoteattr(name)}><mesh>\n<vertices>\n{vertices}</vertices>\n'
        f"<triangles>\n{triangles}</triangles>\n</mesh></object>\n"
    )


def dxf(profile: Profile, features: Iterable[Feature], cuts: Iterable[Feature]) -> bytes:
    """Encode a part as DXF R2010 [mm].

    Args:
        profile: Outline, on layer OUTLINE.
        features: Bores and pockets, on layers BORES and POCKETS.
        cuts: Cuts between the pieces of the part, on layer SPLITS.

    Returns:
        The DXF file.
    """
    ezdxf.options.write_fixed_meta_data_for_testing = True  # else time stamps and random identifiers
    document = ezdxf.new("R2010", units=ezdxf.units.MM)
    for layer, colour in (("OUTLINE", 7), ("BORES", 1), ("POCKETS", 5), ("SPLITS", 3)):
        document.layers.add(layer, color=colour)
    for edge in profile.face.edges():
        _draw_edge(document, edge)
    space = document.modelspace()
    for feature in features:
        if feature.circle is not None:
            centre, radius = feature.circle
            space.add_circle(centre, radius, dxfattribs={"layer": "BORES"})
        else:
            space.add_lwpolyline(feature.outline.exterior.coords[:-1], close=True, dxfattribs={"layer": "POCKETS"})
    for cut in cuts:
        space.add_lwpolyline(cut.outline.exterior.coords[:-1], close=True, dxfattribs={"layer": "SPLITS"})
    for kind in sorted(
        document.entitydb.dxf_types_in_use()
    ):  # else in the order of a set, which depends on the hash seed
        document.classes.add_class(kind)
    text = io.StringIO()
    document.write(text)
    return text.getvalue().encode()


def _draw_edge(document: Drawing, edge: Edge) -> None:
    space, layer = document.modelspace(), {"layer": "OUTLINE"}
    start, middle, end = (edge.position_at(t) for t in (0.0, 0.5, 1.0))
    if edge.geom_type == GeomType.LINE:
        space.add_line((start.X, start.Y), (end.X, end.Y), dxfattribs=layer)
        return
    centre = edge.arc_center
    if edge.is_closed:
        space.add_circle((centre.X, centre.Y), edge.radius, dxfattribs=layer)
        return
    angles = [float(np.degrees(np.arctan2(p.Y - centre.Y, p.X - centre.X))) for p in (start, middle, end)]
    if (angles[1] - angles[0]) % 360.0 > (angles[2] - angles[0]) % 360.0:  # DXF arcs run counter-clockwise
        angles.reverse()
    space.add_arc((centre.X, centre.Y), edge.radius, angles[0], angles[2], dxfattribs=layer)
