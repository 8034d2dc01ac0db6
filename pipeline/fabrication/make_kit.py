"""``puddle fabricate``: from a design to a kit's folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

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

if TYPE_CHECKING:  # the CAD kernel, which takes ten seconds to import
    from tasks.fabrication.checks import KitFinding
    from tasks.fabrication.scaling import JointLoad

DOCS = Path(__file__).resolve().parents[2] / "docs"
"""Where the guides are, in a checkout; a kit takes a copy along."""

GUIDES = ("assembly.md", "servo.md", "servo-wiring.svg")

PHYSICAL_DEPTH = 2.0
"""Of slush, where a design file is simulated [m]. [P]"""

SEVERITIES = ("fault", "warning", "note")


@dataclass(frozen=True)
class KitResult:
    """What came of it."""

    lines: list[str]
    """For the terminal."""
    faults: int


def fabricate(
    design: Path | None, settings: Settings, choices: FabricationSettings, out: Path, *, store: Store, tracker: Tracker
) -> KitResult:
    """Make a kit.

    Args:
        design: a design file; None takes the proposed champion of the study that the settings are of.
        settings: of the study, or those that a design file is simulated under.
        choices: the kit's.
        out: the kit's folder.
        store: of the study.
        tracker: MLflow.

    Raises:
        PuddleError: nothing can be made; nothing was written.
    """
    try:
        require_cad()
    except MissingCadError as error:
        raise PuddleError(str(error)) from None
    place = check_place(out)
    # Late, for the same reason: only once everything else is well.
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
        origin = f"From {design.name}. Simulated in True Slush of {PHYSICAL_DEPTH:g} m as in {settings.name}."
        source = DesignSource(read_design(design), design.stem, origin, settings, PHYSICAL_DEPTH, None)
    try:
        kit = build_kit(source.design, choices.kit)
    except (KitError, SolidError, ServoError, DesignError) as error:
        raise PuddleError(f"{source.name}: {error}") from None
    physics = source.settings.physics.model_copy(update={"passive_joints": "locked", "link_collisions": True})
    simulated = run(
        source.design,
        environments.true_slush(environments.media_of(source.settings, "true_slush"), source.depth),
        label=f"True Slush of {source.depth:g} m",
        physics=physics,
        **source.settings.rollout.model_dump(),
    )
    bench = bench_of(
        source.design,
        kit,
        choices,
        simulated,
        source.members,
        physics,
        tank=source.settings.tank,
        depth=source.depth,
        true_slush=source.true_slush,
    )
    found = sorted((*kit.findings, *bench.findings), key=lambda finding: SEVERITIES.index(finding.severity))
    drawings = {"torque": torque_figure(source.design, bench), "timeline": timeline_figure(bench)}
    title = f"A robot to build: {source.name}"
    faults = sum(finding.severity == "fault" for finding in found)
    files = exports(kit, title=source.name, n_faults=faults)
    files |= {name: (DOCS / name).read_bytes() for name in GUIDES if (DOCS / name).is_file()}
    files["design.json"] = encode_json(design_document(source.design))
    if bench.calibration is not None:
        heading = f"Servos of {source.name}: a {bench.servo.name}'s data sheet. Measure yours: servo.md."
        files["calibration.yaml"] = calibration_yaml(bench.calibration, heading)
        if bench.timeline is not None:
            files["timeline.json"] = timeline_json(bench.timeline, bench.calibration)
            files["timeline.csv"] = timeline_csv(bench.timeline, bench.calibration)
    chosen = choices.model_dump(mode="json")
    files["index.html"] = render_kit(
        kit,
        bench,
        found,
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
    if source.members is not None:
        metrics |= {"ensemble_mean": source.members.mean, "ensemble_deviation": source.members.deviation}
    metrics = {name: value for name, value in metrics.items() if isfinite(value)}
    said: dict[str, Json] = {
        "name": source.name,
        "origin": source.origin,
        "settings": chosen,
        "findings": [{"severity": f.severity, "where": f.where, "message": f.message} for f in found],
        "metrics": metrics,
    }
    kept = write_kit(place, files, said)
    _mirror(tracker, source.name, design is None, source.settings, chosen, metrics, files)
    return KitResult([*kept, *_lines(out, found, bench.loads, kit.mass_g)], faults)


def _lines(out: Path, found: Sequence[KitFinding], loads: Sequence[JointLoad], mass_g: float) -> list[str]:
    lines = [f"{finding.severity:<8} {finding.where}: {finding.message}" for finding in found]
    lines += [f"joint {load.joint}: the servo has {load.margin:.2f} times what the run asks for" for load in loads]
    return [*lines, f"The kit, {mass_g:.0f} g of robot: {out / 'index.html'}"]


def _mirror(
    tracker: Tracker,
    name: str,
    of_study: bool,
    settings: Settings,
    chosen: dict[str, Json],
    metrics: dict[str, float],
    files: dict[str, bytes],
) -> None:
    """Show the kit in MLflow: under its study, or by itself."""
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
