"""``puddle fabricate``: turn a design into a kit's folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from importlib.util import find_spec
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.fabrication.kit_files import KIT, calibration_yaml, timeline_csv, timeline_json, write_folder
from pipeline.fabrication.source import DesignSource, from_file, proposed
from pipeline.stages import environments
from pipeline.store.design_file import design_document
from pipeline.store.encoding import Json, canonical_json, digest, encode_json
from pipeline.store.store import Store
from pipeline.tracking.mirror import Tracker
from pipeline.tracking.run import Run
from tasks.design import DesignError
from tasks.fabrication.kit_settings import FabricationSettings

if TYPE_CHECKING:  # these import the CAD kernel, which takes ten seconds
    from tasks.fabrication.checks import KitFinding
    from tasks.fabrication.scaling import JointLoad

_GUIDES = resources.files("pipeline.fabrication").joinpath("guides")  # pages of docs/, copied into every kit
_SEVERITIES = ("fault", "warning", "note")


@dataclass(frozen=True)
class KitResult:
    """Result of ``puddle fabricate``."""

    lines: list[str]  # lines for the terminal
    n_faults: int


def fabricate(
    design: Path | None, settings: Settings, choices: FabricationSettings, out: Path, *, store: Store, tracker: Tracker
) -> KitResult:
    """Make a kit.

    Args:
        design: Design file; None takes the proposed champion of the study.
        settings: Settings of the study, or those for simulating a design file.
        choices: Settings of the kit.
        out: Folder of the kit.
        store: Store of the study.
        tracker: MLflow mirror.

    Returns:
        The lines to show and the number of faults.

    Raises:
        PuddleError: The kit can't be made. Nothing was written.
    """
    if settings.physics.range_of_motion != "amplitude":
        raise PuddleError(
            f"study {settings.name}: physics.range_of_motion is {settings.physics.range_of_motion}, but a kit's servos "
            "swing by the range to either side: expected amplitude"
        )
    require_cad()
    place = KIT.check_place(out)
    # Imported late, because the CAD kernel takes ten seconds.
    from pipeline.fabrication.bench import bench_of
    from pipeline.fabrication.exports import exports
    from pipeline.fabrication.kit_page import render_kit, verdict
    from tasks.fabrication.features import KitError
    from tasks.fabrication.kit import build_kit
    from tasks.fabrication.profile import SolidError
    from tasks.fabrication.servos import ServoError

    source = proposed(settings, store) if design is None else from_file(design, settings)
    try:
        kit = build_kit(source.design, choices.kit)
    except (KitError, SolidError, ServoError, DesignError) as error:
        raise PuddleError(f"{source.name}: {error}") from None
    physics = source.settings.physics.model_copy(update={"passive_joints": "locked", "link_collisions": True})
    bench = bench_of(source, kit, choices, physics)
    findings = sorted((*kit.findings, *bench.findings), key=lambda finding: _SEVERITIES.index(finding.severity))
    faults = sum(finding.severity == "fault" for finding in findings)
    files = exports(kit, title=source.name, n_faults=faults)
    files |= {guide.name: guide.read_bytes() for guide in _GUIDES.iterdir()}
    files["design.json"] = encode_json(design_document(source.design))
    if bench.calibration is not None:
        heading = f"Servos of {source.name}, from the data sheet of a {bench.servo.name}. Measure yours (servo.md)."
        files["calibration.yaml"] = calibration_yaml(bench.calibration, heading)
        if bench.timeline is not None:
            files["timeline.json"] = timeline_json(bench.timeline, bench.calibration)
            files["timeline.csv"] = timeline_csv(bench.timeline, bench.calibration)
    page = render_kit(kit, bench, source, choices, findings=findings, physics=physics, folder=place.name)
    files["index.html"] = page.encode()
    metrics = {"n_faults": float(faults), "mass_g": kit.mass_g, "submerged_share": bench.floating.sealed_share}
    metrics |= {f"margin.joint_{load.joint}": load.margin for load in bench.loads}
    if source.prediction is not None:
        metrics |= dict(zip(("ensemble_mean", "ensemble_deviation"), source.prediction, strict=True))
    metrics = {name: value for name, value in metrics.items() if isfinite(value)}
    chosen = choices.model_dump(mode="json")
    manifest: dict[str, Json] = {
        "name": source.name,
        "origin": source.origin,
        "settings": chosen,
        "findings": [{"severity": f.severity, "where": f.where, "message": f.message} for f in findings],
        "metrics": metrics,
        "simulated": {
            "depth": source.depth,
            "physics": physics.model_dump(mode="json"),
            "media": {
                name: medium.model_dump(mode="json")
                for name, medium in environments.media_of(source.settings, "true_slush").items()
            },
            "rollout": source.settings.rollout.model_dump(mode="json"),
            "predicted": None if source.predicted is None else list(source.predicted),
        },
    }
    last = f"{verdict(findings)} Kit of a robot of {kit.mass_g:.0f} g: {out / 'index.html'}"
    lines = write_folder(KIT, place, files, manifest)
    _mirror(tracker, source, design is None, chosen, metrics, files)
    return KitResult([*lines, *_lines(findings, bench.loads), last], faults)


def require_cad() -> None:
    """Check that the CAD packages, which take seconds to import, are installed. Raises PuddleError otherwise."""
    missing = [package for package in ("build123d", "ezdxf", "shapely") if find_spec(package) is None]
    if missing:
        raise PuddleError(
            f"{', '.join(missing)} not installed, but needed to make parts. Run `make setup EXTRAS=cad` in the "
            f"checkout; without a checkout, `pip install 'puddle[cad]'`."
        )


def _lines(findings: Sequence[KitFinding], loads: Sequence[JointLoad]) -> list[str]:
    lines = [f"{finding.severity:<8} {finding.where}: {finding.message.rstrip('.')}." for finding in findings]
    lines += [f"joint {load.joint}: the servo gives {load.margin:.2f} times what the run needs" for load in loads]
    return lines


def _mirror(
    tracker: Tracker,
    source: DesignSource,
    of_study: bool,
    chosen: dict[str, Json],
    metrics: dict[str, float],
    files: dict[str, bytes],
) -> None:
    """Mirror the kit to MLflow, under its study or on its own."""
    values = source.settings.model_dump(mode="json")
    key = digest(files["design.json"])
    study = Run(name=source.settings.name, key=digest(canonical_json(values)), params=values)
    if not of_study:
        study = Run(name=f"kit of {source.name}", key=f"kit-{key}", status="FINISHED")
    stage = Run(
        name="fabricate",
        key=f"fabricate-{digest(canonical_json(chosen))[:12]}",
        params=chosen,
        metrics=metrics,
        inputs={"design": key},
        artifacts={f"kit/{path}": content for path, content in files.items()},
        status="FINISHED",
    )
    tracker.mirror(study, stage)
