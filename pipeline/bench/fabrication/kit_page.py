"""index.html of a kit: the robot, the findings, the files to download, and the physics of the scale."""

from collections.abc import Callable, Sequence
from functools import partial
from importlib.resources import files
from itertools import cycle
from math import degrees
from typing import Any

import numpy as np
import yaml
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from pipeline.bench.fabrication.bench import Bench
from pipeline.bench.fabrication.source import DesignSource
from pipeline.report.document import document
from pipeline.report.drawing import FAINT, FIGURE_WIDTH, INK, NothingToDraw, finish
from tasks.bench.fabrication.checks import KitFinding
from tasks.bench.fabrication.kit import Kit
from tasks.bench.fabrication.kit_settings import FabricationSettings
from tasks.bench.fabrication.servos import DIMENSIONS
from tasks.world import Physics

_JOINT_COLOURS = ("#1c6fb8", "#dd7700", "#1d6b3c", "#7d4aa5", "#c2185b")
_SHOWN = 20.0  # of the timeline [s]
_POLICY = "img-src 'self' data: file:"  # the kit's pictures lie beside its page
_TEMPLATES = Environment(
    loader=PackageLoader("pipeline.bench.fabrication", ""), autoescape=True, undefined=StrictUndefined
)


def render_page(template: str, title: str, **values: Any) -> bytes:
    """Render a template of this folder with its style."""
    body = _TEMPLATES.get_template(template).render(title=title, **values)
    css = files("pipeline.bench.fabrication").joinpath("kit.css").read_text("utf-8")
    return document(title=title, policy=_POLICY, body=body, css=f"\n{css}").encode()


def render_kit(
    kit: Kit,
    bench: Bench,
    source: DesignSource,
    choices: FabricationSettings,
    *,
    findings: Sequence[KitFinding],
    physics: Physics,
    folder: str,
) -> bytes:
    """Render the page of a kit in a folder of that name, with the findings of kit and bench, faults first."""
    density = getattr(source.settings.target_medium, "density", 0.0)
    return render_page(
        "kit.html",
        f"A robot to build: {source.name}",
        kit=kit,
        bench=bench,
        source=source,
        servo=kit.servo,
        scaling=choices.scaling,
        findings=findings,
        verdict=verdict(findings),
        figures={
            "torque": _figure("torque", "Loads of the joints and limits of the servo", partial(_torque, kit, bench)),
            "timeline": _figure("gait", "Joint angles on the bench", partial(_timeline, bench)),
        },
        measures=DIMENSIONS,
        physics=physics,
        frequency=float(source.design.frequency[0]),
        simulated_share=physics.link_density / density if density > 0 else None,
        settings_yaml=yaml.safe_dump(choices.model_dump(mode="json"), sort_keys=False),
        folder=folder,
        degrees=degrees,
    )


def verdict(findings: Sequence[KitFinding]) -> str:
    """Say whether a kit should be built, and how many faults and warnings it has."""
    counts = {kind: sum(finding.severity == kind for finding in findings) for kind in ("fault", "warning")}
    counted = {kind: f"{n} {kind}{'s' * (n > 1)}" for kind, n in counts.items()}
    if counts["fault"]:
        return f"Do not build this kit: {counted['fault']}{' and ' + counted['warning'] if counts['warning'] else ''}."
    if counts["warning"]:
        return f"No fault, but {counted['warning']}: read {'them' if counts['warning'] > 1 else 'it'} before you build."
    return "No fault and no warning was found."


def _figure(name: str, title: str, draw: Callable[[], tuple[Figure, str]]) -> Markup:
    """Return a figure, or state why it is missing."""
    try:
        return finish(name, title, draw).html()
    except NothingToDraw as reason:
        return Markup('<p class="absent"><b>{}</b>: not available, because {}.</p>').format(title, reason)


def _torque(kit: Kit, bench: Bench) -> tuple[Figure, str]:
    """Draw the load of every joint against the servo's torque–speed line."""
    if bench.simulated is None:
        raise NothingToDraw("the simulation diverged, or its engine reports no torques")
    if not bench.loads:
        raise NothingToDraw("no joint has a servo")
    figure = Figure(figsize=(FIGURE_WIDTH, 3.3), layout="constrained")
    axes = figure.subplots()
    for column, (load, colour) in enumerate(zip(bench.loads, cycle(_JOINT_COLOURS))):
        torque = bench.simulated.torque[:, column] * bench.scales.torque / kit.settings.servos_per_joint
        speed = bench.simulated.speed[:, column] * bench.scales.frequency
        in_sense = np.sign(torque) * speed
        axes.plot(in_sense, np.abs(torque), ".", ms=2.5, color=colour, alpha=0.6, label=f"joint {load.joint}")
    fastest, stall = kit.servo.no_load_speed_rad_s, kit.servo.stall_torque_nm
    axes.plot([-fastest, 0, fastest], [stall, stall, 0], color=INK, label=kit.servo.name)
    axes.set(xlabel="speed in the direction of the torque [rad/s]", ylabel="torque per servo [N·m]", ylim=(0, None))
    axes.grid(True, color=FAINT)
    figure.legend(loc="outside upper center", ncols=3, markerscale=4, fontsize=9)
    return figure, (
        f"The simulated run at bench scale and the torque–speed line of a {kit.servo.name}, from stall to no load. "
        f"Left of zero the environment moves the joint and the servo brakes."
    )


def _timeline(bench: Bench) -> tuple[Figure, str]:
    """Draw the start of the timeline."""
    if bench.timeline is None:
        raise NothingToDraw(
            "the servos can't play this gait; the findings say why" if bench.calibration else "no joint has a servo"
        )
    figure = Figure(figsize=(FIGURE_WIDTH, 2.6), layout="constrained")
    axes = figure.subplots()
    time = bench.timeline.time
    shown = time <= _SHOWN
    for column, (joint, colour) in enumerate(zip(bench.timeline.joints, cycle(_JOINT_COLOURS))):
        axes.plot(time[shown], np.degrees(bench.timeline.angle[shown, column]), color=colour, label=f"joint {joint}")
    axes.set(xlabel="time [s]", ylabel="angle from rest [°]")
    axes.grid(True, color=FAINT)
    figure.legend(loc="outside upper center", ncols=5, fontsize=9, columnspacing=1.2, handlelength=1.2)
    return figure, (
        f"The first {min(_SHOWN, time[-1]):.0f} of {time[-1]:.0f} s. The amplitude rises from rest to the evolved "
        f"gait; at the end it falls in the same way."
    )
