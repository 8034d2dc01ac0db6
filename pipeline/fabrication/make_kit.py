"""``puddle fabricate``: turn a design into a kit's folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import yaml

from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.fabrication.choices import FabricationSettings
from pipeline.fabrication.kit_folder import check_place, write_kit
from pipeline.fabrication.timeline_file import calibration_yaml, timeline_csv, timeline_json
from pipeline.stages import environments
from pipeline.store.design_file import design_document, read_design
from pipeline.store.encoding import Json, canonical_json, digest, encode_json
from pipeline.store.store import Store
from pipeline.tracking.mirror import Run, Tracker
from tasks.design import DesignError
from tasks.fabrication.cad import MissingCadError, require_cad

if TYPE_CHECKING:  # these import the CAD kernel, which takes ten seconds
    from tasks.fabrication.checks import KitFinding
    from tasks.fabrication.scaling import JointLoad

_DOCS = Path(__file__).resolve().parents[2] / "docs"  # of a checkout
_GUIDES = ("assembly.md", "servo.md", "servo-wiring.svg")  # copied into every kit
_PHYSICAL_DEPTH = 2.0  # of the slush in which a design file is simulated [m]; paper, "Physical Validation"
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
    try:
        require_cad()
    except MissingCadError as error:
        raise PuddleError(str(error)) from None
    place = check_place(out)
    # Imported late, because the CAD kernel takes ten seconds.
    from pipeline.fabrication.bench import bench_of, run
    from pipeline.fabrication.exports import exports
    from pipeline.fabrication.kit_figures import timeline_figure, torque_figure
    from pipeline.fabrication.kit_page import render_kit
    from pipeline.fabrication.source import DesignSource, proposed
    from tasks.fabrication.features import KitError
    from tasks.fabrication.kit import build_kit
    from tasks.fabrication.profile import SolidError
    from tasks.fabrication.servos import ServoError

    if design is None:
        source = proposed(settings, store)
    else:
        where = f"True Slush at {_PHYSICAL_DEPTH:g} m"
        origin = f"Design file {design.name}, simulated in {where} with the settings of {settings.name}."
        source = DesignSource(read_design(design), design.stem, origin, settings, _PHYSICAL_DEPTH, None)
    try:
        kit = build_kit(source.design, choices.kit)
    except (KitError, SolidError, ServoError, DesignError) as error:
        raise PuddleError(f"{source.name}: {error}") from None
    physics = source.settings.physics.model_copy(update={"passive_joints": "locked", "link_collisions": True})
    simulated = run(
        source.design,
        environments.true_slush(environments.media_of(source.settings, "true_slush"), source.depth),
        label=f"True Slush at {source.depth:g} m",
        physics=physics,
        **source.settings.rollout.model_dump(),
    )
    bench = bench_of(
        source.design,
        kit,
        choices,
        simulated,
        source.predicted,
        physics,
        tank=source.settings.tank,
        depth=source.depth,
        true_slush=source.true_slush,
    )
    findings = sorted((*kit.findings, *bench.findings), key=lambda finding: _SEVERITIES.index(finding.severity))
    drawings = {"torque": torque_figure(source.design, bench), "timeline": timeline_figure(bench)}
    title = f"A robot to build: {source.name}"
    faults = sum(finding.severity == "fault" for finding in findings)
    files = exports(kit, title=source.name, n_faults=faults)
    files |= {name: (_DOCS / name).read_bytes() for name in _GUIDES if (_DOCS / name).is_file()}
    files["design.json"] = encode_json(design_document(source.design))
    if bench.calibration is not None:
        heading = f"Servos of {source.name}, from the data sheet of a {bench.servo.name}. Measure yours (servo.md)."
        files["calibration.yaml"] = calibration_yaml(bench.calibration, heading)
        if bench.timeline is not None:
            files["timeline.json"] = timeline_json(bench.timeline, bench.calibration)
            files["timeline.csv"] = timeline_csv(bench.timeline, bench.calibration)
    chosen = choices.model_dump(mode="json")
    files["index.html"] = render_kit(
        kit,
        bench,
        findings,
        drawings,
        name=source.name,
        title=title,
        origin=source.origin,
        folder=place.name,
        law=choices.scaling.law,
        physics=physics,
        slush_density=source.settings.slush.density,
        frequency=float(source.design.frequency[0]),
        settings_yaml=yaml.safe_dump(chosen, sort_keys=False),
    ).encode()
    metrics = {"n_faults": float(faults), "mass_g": kit.mass_g, "submerged_share": bench.floating.sealed_share}
    metrics |= {f"margin.joint_{load.joint}": load.margin for load in bench.loads}
    if source.predicted is not None:
        mean, deviation = float(np.mean(source.predicted)), float(np.std(source.predicted))
        metrics |= {"ensemble_mean": mean, "ensemble_deviation": deviation}
    metrics = {name: value for name, value in metrics.items() if isfinite(value)}
    manifest: dict[str, Json] = {
        "name": source.name,
        "origin": source.origin,
        "settings": chosen,
        "findings": [{"severity": f.severity, "where": f.where, "message": f.message} for f in findings],
        "metrics": metrics,
    }
    lines = write_kit(place, files, manifest)
    _mirror(tracker, source.name, design is None, source.settings, chosen, metrics, files)
    return KitResult([*lines, *_lines(out, findings, bench.loads, kit.mass_g)], faults)


def _lines(out: Path, findings: Sequence[KitFinding], loads: Sequence[JointLoad], mass_g: float) -> list[str]:
    lines = [f"{finding.severity:<8} {finding.where}: {finding.message.rstrip('.')}." for finding in findings]
    lines += [f"joint {load.joint}: the servo gives {load.margin:.2f} times what the run needs" for load in loads]
    return [*lines, f"Kit of a robot of {mass_g:.0f} g: {out / 'index.html'}"]


def _mirror(
    tracker: Tracker,
    name: str,
    of_study: bool,
    settings: Settings,
    chosen: dict[str, Json],
    metrics: dict[str, float],
    files: dict[str, bytes],
) -> None:
    """Mirror the kit to MLflow, under its study or on its own."""
    values = settings.model_dump(mode="json")
    key = digest(files["design.json"])
    study = Run(name=settings.name, key=digest(canonical_json(values)), params=values)
    if not of_study:
        study = Run(name=f"kit of {name}", key=f"kit-{key}", status="FINISHED")
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
