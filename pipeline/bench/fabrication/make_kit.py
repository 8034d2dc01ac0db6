"""``puddle fabricate``: turn a design into a kit's folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic_core import to_jsonable_python

from pipeline.bench.fabrication.kit_files import KIT, calibration_yaml, timeline_json, write_folder
from pipeline.bench.fabrication.source import DesignSource, as_built
from pipeline.errors import PuddleError
from pipeline.stages import environments
from pipeline.store.design_file import design_json
from pipeline.store.encoding import Json
from tasks.bench.fabrication.kit_error import KitError
from tasks.bench.fabrication.kit_settings import FabricationSettings
from tasks.design import DesignError
from tasks.world import Physics

if TYPE_CHECKING:
    from pipeline.bench.fabrication.bench import Bench
    from tasks.bench.fabrication.checks import KitFinding
    from tasks.bench.fabrication.kit import Kit

_GUIDES = resources.files("pipeline.bench.fabrication").joinpath("guides")  # pages of docs/, copied into every kit


def fabricate(source: DesignSource, choices: FabricationSettings, out: Path) -> tuple[list[str], int]:
    """Make the kit of a design in a folder that is new or a kit. Returns lines for the terminal, and how many faults.

    Raises PuddleError if the kit can't be made; nothing was written.
    """
    require_cad()
    place = KIT.check_place(out)
    # Imported late, because the CAD kernel takes ten seconds.
    from pipeline.bench.fabrication.bench import bench_of
    from pipeline.bench.fabrication.exports import exports
    from pipeline.bench.fabrication.kit_page import render_kit, verdict
    from tasks.bench.fabrication.kit import build_kit

    try:
        kit = build_kit(source.design, choices.kit)
    except (KitError, DesignError) as error:
        raise PuddleError(f"{source.name}: {error}") from None
    physics = as_built(source.settings.physics)
    bench = bench_of(source, kit, choices, physics)
    findings = sorted((*kit.findings, *bench.findings), key=lambda finding: finding.severity)  # faults first
    n_faults = sum(finding.severity == "fault" for finding in findings)
    files = exports(kit, title=source.name)
    files |= {guide.name: guide.read_bytes() for guide in _GUIDES.iterdir()}
    files |= {"design.json": design_json(source.design)} | _servo_files(bench, source, kit)
    files["index.html"] = render_kit(kit, bench, source, choices, findings=findings, physics=physics, folder=place.name)
    manifest = _manifest(source, choices, findings, physics)
    lines = write_folder(KIT, place, files, manifest)
    if any(line.startswith("Preserved calibration.yaml") for line in lines):
        lines.append(
            "`puddle servo play` now has values of the data sheet: calibrate again, or put yours in their place"
        )
    lines += [f"{finding.severity:<8} {finding.where}: {finding.message.rstrip('.')}." for finding in findings]
    lines += [f"joint {load.joint}: the servo gives {load.margin:.2f} times what the run needs" for load in bench.loads]
    last = f"{verdict(findings)} Kit of a robot of {kit.mass_g:.0f} g: {out / 'index.html'}"
    return [*lines, last], n_faults


def _servo_files(bench: Bench, source: DesignSource, kit: Kit) -> dict[str, bytes]:
    if bench.calibration is None:
        return {}
    heading = f"Servos of {source.name}, from the data sheet of a {kit.servo.name}. Measure yours (servo.md)."
    files = {"calibration.yaml": calibration_yaml(bench.calibration, heading)}
    if bench.timeline is not None:
        files["timeline.json"] = timeline_json(bench.timeline, bench.calibration)
    return files


def _manifest(
    source: DesignSource, choices: FabricationSettings, findings: Sequence[KitFinding], physics: Physics
) -> dict[str, Json]:
    """Return what a kit records: its findings, and its simulation, with which compare-run compares the robot's run."""
    return {
        "name": source.name,
        "origin": source.origin,
        "settings": choices.model_dump(mode="json"),
        "findings": [asdict(finding) for finding in findings],
        "simulated": {
            "environment": source.settings.target,
            "depth": source.depth,
            "physics": physics.model_dump(mode="json"),
            "media": to_jsonable_python(environments.media_of(source.settings, source.settings.target)),
            "rollout": source.settings.rollout.model_dump(mode="json"),
            "predicted": None if source.predicted is None else list(source.predicted),
        },
    }


def require_cad() -> None:
    """Check that the CAD packages, which take seconds to import, are installed. Raises PuddleError otherwise."""
    missing = [package for package in ("build123d", "shapely") if find_spec(package) is None]
    if missing:
        raise PuddleError(
            f"{', '.join(missing)} not installed, but needed to make parts. Run `make setup EXTRAS=cad` in the "
            f"checkout; without a checkout, `pip install 'puddle[cad]'`."
        )
