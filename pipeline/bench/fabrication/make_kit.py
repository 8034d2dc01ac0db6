"""``puddle fabricate``: turn a design into a kit's folder."""

from __future__ import annotations

from importlib import resources
from importlib.util import find_spec
from math import isfinite
from pathlib import Path

from pydantic_core import to_jsonable_python

from pipeline.bench.fabrication.kit_files import KIT, calibration_yaml, timeline_json, write_folder
from pipeline.bench.fabrication.source import DesignSource
from pipeline.errors import PuddleError
from pipeline.stages import environments
from pipeline.store.design_file import design_json
from pipeline.store.encoding import Json
from tasks.bench.fabrication.kit_error import KitError
from tasks.bench.fabrication.kit_settings import FabricationSettings
from tasks.design import DesignError

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
    physics = source.settings.physics.model_copy(update={"passive_joints": "locked", "link_collisions": True})
    bench = bench_of(source, kit, choices, physics)
    findings = sorted((*kit.findings, *bench.findings), key=lambda finding: finding.severity)  # faults first
    n_faults = sum(finding.severity == "fault" for finding in findings)
    files = exports(kit, title=source.name, n_faults=n_faults)
    files |= {guide.name: guide.read_bytes() for guide in _GUIDES.iterdir()}
    files["design.json"] = design_json(source.design)
    if bench.calibration is not None:
        heading = f"Servos of {source.name}, from the data sheet of a {kit.servo.name}. Measure yours (servo.md)."
        files["calibration.yaml"] = calibration_yaml(bench.calibration, heading)
        if bench.timeline is not None:
            files["timeline.json"] = timeline_json(bench.timeline, bench.calibration)
    files["index.html"] = render_kit(kit, bench, source, choices, findings=findings, physics=physics, folder=place.name)
    metrics = {"n_faults": float(n_faults), "mass_g": kit.mass_g, "submerged_share": bench.floating.sealed_share}
    metrics |= {f"margin.joint_{load.joint}": load.margin for load in bench.loads if isfinite(load.margin)}
    media = environments.media_of(source.settings, source.settings.target)
    manifest: dict[str, Json] = {
        "name": source.name,
        "origin": source.origin,
        "settings": choices.model_dump(mode="json"),
        "findings": [{"severity": f.severity, "where": f.where, "message": f.message} for f in findings],
        "metrics": metrics,
        "simulated": {
            "environment": source.settings.target,
            "depth": source.depth,
            "physics": physics.model_dump(mode="json"),
            "media": to_jsonable_python(media),
            "rollout": source.settings.rollout.model_dump(mode="json"),
            "predicted": None if source.predicted is None else list(source.predicted),
        },
    }
    lines = write_folder(KIT, place, files, manifest)
    lines += [f"{finding.severity:<8} {finding.where}: {finding.message.rstrip('.')}." for finding in findings]
    lines += [f"joint {load.joint}: the servo gives {load.margin:.2f} times what the run needs" for load in bench.loads]
    last = f"{verdict(findings)} Kit of a robot of {kit.mass_g:.0f} g: {out / 'index.html'}"
    return [*lines, last], n_faults


def require_cad() -> None:
    """Check that the CAD packages, which take seconds to import, are installed. Raises PuddleError otherwise."""
    missing = [package for package in ("build123d", "shapely") if find_spec(package) is None]
    if missing:
        raise PuddleError(
            f"{', '.join(missing)} not installed, but needed to make parts. Run `make setup EXTRAS=cad` in the "
            f"checkout; without a checkout, `pip install 'puddle[cad]'`."
        )
