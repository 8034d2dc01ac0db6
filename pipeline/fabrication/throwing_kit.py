"""``puddle fabricate --throwing-kit``: bars to throw, their tags, a calibration board and a protocol, in one folder."""

from __future__ import annotations

import csv
import io
from importlib.resources import files as package_files
from pathlib import Path

import yaml

from pipeline.errors import PuddleError
from pipeline.fabrication.make_kit import require_cad
from pipeline.store.owned_folder import FolderKind
from pipeline.vision import require_vision
from tasks.fabrication.kit_settings import FabricationSettings
from tasks.fabrication.throwing_bars import BarError, ThrowingBar, throwing_bars
from tasks.world import froude_time

THROWING_KIT = FolderKind("a throwing kit", "puddle.throwing-kit", 1, "throwing-kit.json")
MARKERS = "markers.yaml"

_HEADING = "# Which tag is where. Measure the tank's tags between their centres and correct x, y and waterline [m].\n"
_POLICY = "img-src 'self' data: file:"  # the kit's pictures lie beside its page


def make_throwing_kit(choices: FabricationSettings, out: Path) -> list[str]:
    """Make a kit of bars to throw.

    Args:
        choices: settings of the kit, its scale and its bars.
        out: the folder, new or a throwing kit to replace.

    Returns:
        Lines for the terminal.

    Raises:
        PuddleError: a bar can't be made, or a package is missing. Nothing was written.
    """
    require_vision()
    require_cad()
    place = THROWING_KIT.check_place(out)
    from pipeline.fabrication.formats import stl, three_mf
    from pipeline.fabrication.kit_page import TEMPLATES
    from pipeline.report.moving import document
    from pipeline.vision.kit_markers import markers_of
    from pipeline.vision.tag_sheets import tag_sheets
    from tasks.fabrication.bar_solids import plate_of
    from tasks.fabrication.parts import mesh_of

    settings, throwing = choices.kit, choices.throwing
    try:
        bars = throwing_bars(throwing, settings, choices.scaling.fluid_density)
    except BarError as error:
        raise PuddleError(str(error)) from None
    markers = markers_of(throwing, bars)
    made = tag_sheets(markers, [bar.name for bar in bars])
    for bar in bars:
        mesh = mesh_of(plate_of(bar, settings))
        mesh = type(mesh)(mesh.vertices - mesh.vertices.min(axis=0), mesh.triangles)
        made |= {f"print/{bar.name}.stl": stl(mesh), f"print/{bar.name}.3mf": three_mf([(bar.name, mesh)])}
    made["bars.csv"] = _bars_csv(bars)
    made[MARKERS] = (_HEADING + yaml.safe_dump(markers.model_dump(mode="json"), sort_keys=False)).encode()
    reach_mm = max(throwing.lengths) * settings.scale_mm_per_m  # twice as far as a link that touches the surface
    body = TEMPLATES.get_template("throwing_kit.html").render(
        bars=bars,
        kit=settings,
        throwing=throwing,
        markers=markers,
        sheets=sorted(name.removesuffix(".svg") for name in made if name.endswith(".svg")),
        speed=settings.scale_mm_per_m / 1000 / froude_time(settings.scale_mm_per_m / 1000),
        rod_length=settings.pitch_mm + settings.thickness_mm,
        smallest_module=min(bar.tag_mm for bar in bars) / 6,
        highest_mm=min(1000 * (throwing.tank_height - throwing.waterline), reach_mm),
        lowest_mm=min(1000 * throwing.waterline, reach_mm),
    )
    css = package_files("pipeline.fabrication").joinpath("kit.css").read_text("utf-8")
    made["index.html"] = document(title="Bars to throw", policy=_POLICY, body=body, css=f"\n{css}").encode()
    with THROWING_KIT.replace(place, {"settings": choices.model_dump(mode="json")}) as new:
        for name, content in made.items():
            new.write(name, content)
    lines = [
        f"{bar.name}: {bar.length_mm:.0f} × {bar.width_mm:.0f} mm, {bar.mass_g:.0f} g: two plates of {bar.plate_g:.0f} "
        f"g ({bar.infill:.0%} infill), rods of {bar.rods_g:.0f} g at ±{bar.rod_at_mm:.0f} mm, {bar.trim_g:+.1f} g there"
        for bar in bars
    ]
    return [*new.preserved, *lines, f"Bars to throw, tags and protocol: {out / 'index.html'}"]


def _bars_csv(bars: tuple[ThrowingBar, ...]) -> bytes:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("name", "length_mm", "width_mm", "rod_at_mm", "infill", "plate_g", "rods_g", "trim_g", "mass_g"))
    for bar in bars:
        sides = [f"{value:.1f}" for value in (bar.length_mm, bar.width_mm, bar.rod_at_mm)]
        masses = [f"{value:.1f}" for value in (bar.plate_g, bar.rods_g, bar.trim_g, bar.mass_g)]
        rows.writerow((bar.name, *sides, f"{bar.infill:.2f}", *masses))
    return text.getvalue().encode()
