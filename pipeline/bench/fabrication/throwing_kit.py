"""``puddle fabricate --throwing-kit``: bars to throw, their tags, a calibration board and a protocol, in one folder."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, degrees, sin, tau
from pathlib import Path

import yaml
from pydantic import ValidationError

from pipeline.bench.fabrication.kit_files import write_folder
from pipeline.bench.fabrication.make_kit import require_cad
from pipeline.bench.vision import require_vision
from pipeline.errors import PuddleError
from pipeline.store.owned_folder import FolderKind
from tasks.bench.fabrication.kit_error import KitError
from tasks.bench.fabrication.kit_settings import FabricationSettings
from tasks.bench.fabrication.throwing_bars import ThrowingBar, throwing_bars
from tasks.residual.robot_ranges import robot_ranges
from tasks.residual.throws import even_starts
from tasks.seeding import generator
from tasks.world import Physics, froude_time

THROWING_KIT = FolderKind("a throwing kit", "puddle.throwing-kit", 1, "throwing-kit.json")
MARKERS = "markers.yaml"

_HEADING = "# Which tag is where. Measure the tank's tags between their centres and correct x, y and waterline [m].\n"


def make_throwing_kit(choices: FabricationSettings, out: Path) -> list[str]:
    """Make a kit of bars to throw in a folder that is new or a throwing kit. Returns lines for the terminal.

    Raises PuddleError if a bar can't be made, or a package is missing; nothing was written.
    """
    require_vision()
    require_cad()
    place = THROWING_KIT.check_place(out)
    from pipeline.bench.fabrication.exports import stl
    from pipeline.bench.fabrication.kit_page import render_page
    from pipeline.bench.vision.markers_file import markers_of
    from pipeline.bench.vision.tag_sheets import tag_sheets
    from tasks.bench.fabrication.parts import mesh_of, plate_of

    settings, throwing = choices.kit, choices.throwing
    try:
        bars = throwing_bars(throwing, settings, choices.scaling.fluid_density)
        markers = markers_of(throwing, bars)
    except KitError as error:
        raise PuddleError(str(error)) from None
    except ValidationError as error:
        said = "; ".join(found["msg"].removeprefix("Value error, ") for found in error.errors())
        raise PuddleError(f"throwing: {said}") from None
    highest = throwing.tank_height - throwing.waterline
    throws = starts_of(bars, settings.scale_mm_per_m / 1000, lowest=-throwing.waterline, highest=highest)
    made = tag_sheets(markers, [bar.name for bar in bars])
    for bar in bars:
        made[f"print/{bar.name}.stl"] = stl(mesh_of(plate_of(bar, settings)).on_bed())
    made[MARKERS] = (_HEADING + yaml.safe_dump(markers.model_dump(mode="json"), sort_keys=False)).encode()
    made["index.html"] = render_page(
        "throwing_kit.html",
        "Bars to throw",
        bars=bars,
        throws=throws,
        kit=settings,
        throwing=throwing,
        markers=markers,
        sheets=sorted(name for name in made if name.endswith(".png")),
        rod_length=settings.pitch_mm + settings.thickness_mm,
        smallest_module=min(bar.tag_mm for bar in bars) / 6,
    )
    preserved = write_folder(THROWING_KIT, place, made, {"settings": choices.model_dump(mode="json")})
    lines = [
        f"{bar.name}: {bar.length_mm:.0f} × {bar.width_mm:.0f} mm, {bar.mass_g:.0f} g: two plates of {bar.plate_g:.0f} "
        f"g ({bar.infill:.0%} infill), rods of {bar.rods_g:.0f} g at ±{bar.rod_at_mm:.0f} mm, {bar.trim_g:+.1f} g there"
        for bar in bars
    ]
    return [*preserved, *lines, f"Bars to throw, tags and protocol: {out / 'index.html'}"]


_N_THROWS = 64  # a power of 2, whose starts are balanced


def starts_of(bars: Sequence[ThrowingBar], scale: float, *, lowest: float, highest: float) -> list[tuple[str, ...]]:
    """Return starts that are spread evenly over the states of robots' links, with the bars and in the tank there are.

    Args:
        bars: bars of the kit.
        scale: bench metres per simulated metre.
        lowest: least height over the water that the tank's tags show [m], of a whole bar.
        highest: greatest height.
    """
    ranges, time = robot_ranges(Physics()), froude_time(scale)
    heights = max(lowest / scale, -ranges.y_reach), min(highest / scale, ranges.y_reach)
    starts = even_starts(_N_THROWS, Physics(), generator(0, "throwing kit"), heights=heights)
    low, high = (1000 * scale * height for height in heights)  # [mm], as is what follows
    middle, half_range, rows = (low + high) / 2, (high - low) / 2, []
    for length, (_, y, angle, vx, vy, omega) in zip(starts.length_scale, starts.state.tolist(), strict=True):
        bar = min(bars, key=lambda bar: abs(bar.length_scale - length))
        reach = (bar.length_mm * abs(cos(angle)) + bar.width_mm * abs(sin(angle))) / 2
        height = middle + (1000 * scale * y - middle) * max(1 - reach / half_range, 0)  # the whole bar is in view
        velocity = (f"{value * scale / time:z.2f}" for value in (vx, vy))
        rows.append((bar.name, f"{height:z.0f}", f"{degrees(angle):.0f}", *velocity, f"{omega / tau / time:z.1f}"))
    return rows
