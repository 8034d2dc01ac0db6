"""index.html of a kit: the robot, the findings, the files to download, and the physics of the scale."""

from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from math import degrees
from string import Template

import numpy as np

from pipeline.fabrication.bench import Bench
from pipeline.report.drawing import Drawing, Missing
from pipeline.report.moving import document
from pipeline.report.page import inline_svg
from pipeline.report.wording import absent
from tasks.fabrication.checks import KitFinding
from tasks.fabrication.kit import Kit
from tasks.fabrication.servos import MEASURES, Servo
from tasks.world import Physics

_POLICY = "img-src 'self' data: file:"  # the kit's pictures lie beside its page

_LAWS = {
    "froude": "Froude's law: gravity, buoyancy, drag and inertia keep their proportions, so the simulation predicts "
    "the motion on the bench. Times shrink by the square root of the scale, which takes fast servos.",
    "kept_frequencies": "Kept frequencies: a second stays a second. Gravity and buoyancy keep their proportion, but "
    "inertia and drag are weaker by the scale. The robot moves slowly, within reach of more servos, but not as "
    "simulated: the distance and speed below are no prediction.",
}


def render_kit(
    kit: Kit,
    bench: Bench,
    findings: Sequence[KitFinding],
    drawings: dict[str, Drawing | Missing],
    *,
    name: str,
    title: str,
    origin: str,
    folder: str,
    law: str,
    physics: Physics,
    slush_density: float,
    frequency: float,
    settings_yaml: str,
) -> str:
    """Render the page.

    Args:
        kit: The kit.
        bench: Loads, floating and timeline.
        findings: Findings of both, faults first.
        drawings: Figures of :mod:`pipeline.fabrication.kit_figures`.
        name: Name of the design.
        title: Title of the page.
        origin: Where the design comes from, in words.
        folder: Name of the kit on a command line.
        law: Scaling law.
        physics: Physics of the simulation.
        slush_density: Density of the simulated slush [kg/m²].
        frequency: Frequency of the gait [Hz of simulation].
        settings_yaml: Settings of the kit.

    Returns:
        The HTML document.
    """
    n = sum(finding.severity == "fault" for finding in findings)
    verdict = (
        f'<div class="notice"><b>Do not build this kit.</b> It has {n} {"fault" if n == 1 else "faults"}: see the '
        f"findings.</div>"
        if n
        else '<p class="finding">No fault found.</p>'
    )
    pieces = {
        "title": escape(title),
        "name": escape(name),
        "verdict": verdict,
        "origin": f"<p>{escape(origin)}</p>",
        "findings": _findings(findings),
        "parts": _parts(kit),
        "measures": _measures(kit, bench.servo),
        "bill": _bill(kit),
        "scale": _scale(bench, drawings["torque"], law, physics, slush_density, frequency),
        "timeline": _timeline(bench, drawings["timeline"]),
        "last": _last_steps(bench, folder),
        "chosen": f"<details><summary>Settings</summary><pre><code>{escape(settings_yaml)}</code></pre></details>",
    }
    body, css = (files("pipeline.fabrication").joinpath(f"kit.{kind}").read_text("utf-8") for kind in ("html", "css"))
    return document(title=pieces["title"], policy=_POLICY, body=Template(body).substitute(pieces), css=f"\n{css}")


def _table(head: Sequence[str], rows: Iterable[Sequence[str]], kind: str = "") -> str:
    """Lay out cells of HTML; on a narrow screen a row becomes a list whose items name their column."""
    top = "".join(f"<th>{cell}</th>" for cell in head)
    lines = (
        "".join(f'<td data-column="{name}">{cell}</td>' for name, cell in zip(head, row, strict=True)) for row in rows
    )
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return (
        f'<div class="scroll"><table class="rows {kind}"><thead><tr>{top}</tr></thead><tbody>{body}</tbody>'
        f"</table></div>"
    )


def _figure(drawing: Drawing | Missing) -> str:
    if isinstance(drawing, Missing):
        return absent(drawing.title, drawing.reason)
    caption = f"<figcaption>{escape(drawing.description)}</figcaption>"
    return f'<figure id="{drawing.name}"><h3>{escape(drawing.title)}</h3>{inline_svg(drawing)}{caption}</figure>'


def _findings(findings: Sequence[KitFinding]) -> str:
    if not findings:
        return "<p>None.</p>"
    items = "".join(
        f'<li class="{one.severity}"><b>{one.severity}</b> · {escape(one.where)}: '
        f"{escape(one.message.rstrip('.'))}.</li>"
        for one in findings
    )
    return f'<ul class="found">{items}</ul>'


def _parts(kit: Kit) -> str:
    rows = []
    for part in kit.parts:
        links = [f'<a href="print/{part.name}.{form}">{form.upper()}</a>' for form in ("stl", "3mf")]
        links += [f'<a href="cad/{part.name}.step">STEP</a>']
        left, bottom, right, top = part.outline.bounds
        size = f"{right - left:.0f} × {top - bottom:.0f}"
        rows.append([escape(part.name), size, f"{part.mass_g:.0f}", " ".join(links)])
    names = [f"part-{body + 1}-{side}" for body, side in kit.features]
    profiles = " ".join(f'<a href="profiles/{name}.dxf">{name}</a>' for name in names)
    return _table(["part", "size [mm]", "mass [g]", "files"], rows) + f"<p>Profiles (DXF): {profiles}</p>"


def _measures(kit: Kit, servo: Servo) -> str:
    if not kit.gauges:
        return "<p>No joint has a servo to measure.</p>"
    (horn,) = servo.horns
    rows = []
    for name, words in MEASURES.items():
        value = getattr(horn if hasattr(horn, name) else servo, name)
        source = escape(servo.sources.get(name, "none (a typical value)"))
        rows.append([f"<code>{name}</code>", words, f"{value:g}", source])
    prints = ", ".join(
        f'{gauge.name} ({gauge.mass_g:.0f} g: <a href="print/{gauge.name}.stl">STL</a> '
        f'<a href="print/{gauge.name}.3mf">3MF</a>)'
        for gauge in kit.gauges
    )
    return (
        f"<p>Clones of a {escape(servo.name)} differ, and so do their horns. Print the two gauges before the parts: "
        f"{prints}. They are slices of the parts. The servo enters the first from above until its ears lie on the "
        f"plate, and its screws meet the holes. The horn lies in the second with its face on the floor. With both "
        f"gauges on the servo, the gap between them must be {kit.settings.layer_gap_mm:g} mm. If anything does not "
        f"fit, measure it and make the kit again with your value: "
        f"<code>--set kit.measured.length_mm=40.1</code>.</p>"
        f"<details><summary>Dimensions of this kit and their sources</summary>"
        f"{_table(['name', 'dimension', 'mm', 'source'], rows, 'left')}</details>"
    )


def _bill(kit: Kit) -> str:
    rows = []
    for line in kit.bill:
        length = "" if line.length_mm is None else f"{line.length_mm:.1f}"
        mass = "" if line.mass_g is None else f"{line.mass_g:.0f}"
        rows.append([escape(line.item), str(line.count), length, mass, escape(line.note)])
    rows.append(["<b>total</b>", "", "", f"<b>{kit.mass_g:.0f}</b>", "prints, servos and steel"])
    return _table(["item", "count", "length [mm]", "mass [g]", "note"], rows, "noted")


def _scale(
    bench: Bench, figure: Drawing | Missing, law: str, physics: Physics, slush_density: float, frequency: float
) -> str:
    scales, servo, floating, run = bench.scales, bench.servo, bench.floating, bench.simulated
    limit = physics.max_motor_torque * scales.torque
    stall = servo.stall_torque_nm * bench.servos_per_joint
    units = [
        ["length", "1 m", f"{1000 * scales.length:.0f} mm"],
        ["time", "1 s", f"{scales.time:.3f} s"],
        ["mass of the robot", f"{floating.mass_kg / scales.mass:.1f} kg", f"{1000 * floating.mass_kg:.0f} g"],
        ["torque limit of a motor", f"{physics.max_motor_torque:g} N·m", f"{limit:.3f} N·m"],
        ["fastest gait", "0.3 Hz", f"{0.3 * scales.frequency:.2f} Hz"],
        ["this gait", f"{frequency:.3f} Hz", f"{frequency * scales.frequency:.2f} Hz"],
    ]
    if run is not None:
        metres = run.com_displacement
        distance = f"{100 * metres * scales.length:+.0f} cm in {run.duration * scales.time:.0f} s"
        what = f"displacement of the centre of mass in {escape(run.environment)} in {run.duration:.0f} s"
        units.append([what, f"{metres:+.2f} m", distance])
    loads = [
        [
            f"joint {load.joint}",
            *(f"{load.peak_torque:.3f}", f"{load.rms_torque:.3f}", f"{load.peak_speed:.2f}"),
            *(f"{load.margin:.2f}×", f"{load.saturated:.0%}"),
        ]
        for load in bench.loads
    ]
    head = ["servo of", "peak torque [N·m]", "rms torque [N·m]", "peak speed [rad/s]", "least margin", "motor at limit"]
    ratio, comparison = max(stall, limit) / max(min(stall, limit), 1e-12), "stronger" if stall > limit else "weaker"
    unlike = (
        ". Where the simulated robot was too weak, such as on dry land, this one may not be" if stall > limit else ""
    )
    return "".join(
        [
            f"<p>{escape(_LAWS[law])}</p>",
            "<p>The paper gives the scale of lengths but not of times, and reports whether the robot crosses the tank, "
            "not how fast. The virtual tank of a study always uses Froude's law. To choose the other law, use "
            "<code>--set scaling.law=…</code>.</p>",
            _table(["", "in simulation", "on the bench"], units, "left"),
            f"<p>A {escape(servo.name)} has {servo.stall_torque_nm:.2f} N·m at stall and "
            f"{servo.no_load_speed_rad_s:.1f} rad/s unloaded, at {servo.voltage_v:g} V. Each joint has "
            f"{bench.servos_per_joint}, which is {ratio:.1f} times {comparison} than the simulated motor at this "
            f"scale{unlike}. The last column is the share of the run in which the simulated motor was at its torque "
            f"limit.</p>",
            _table(head, loads) if loads else "",
            _figure(figure),
            _floating(bench, physics, slush_density),
            _prediction(bench),
        ]
    )


def _floating(bench: Bench, physics: Physics, slush_density: float) -> str:
    floating = bench.floating
    if floating.draught_mm is None:
        state = f"It sinks: it weighs {floating.sealed_share:.2f} times the fluid that it can displace."
    else:
        state = (
            f"It floats with {floating.sealed_share:.0%} of its volume submerged. In its rest pose, as drawn, the "
            f"draught is {floating.draught_mm:.0f} mm of {floating.height_mm:.0f} mm."
        )
    simulated = physics.link_density / slush_density if slush_density > 0 else float("inf")
    flooded = "sinks" if floating.flooded_share > 1 else "still floats"
    return (
        f"<p>The robot has a mass of {1000 * floating.mass_kg:.0f} g and a volume of {1e6 * floating.sealed_m3:.0f} "
        f"cm³. {state} The simulated robot has {simulated:.0%} submerged; add weights or foam to match it. With "
        f"flooded pockets it {flooded} ({floating.flooded_share:.0%} of the remaining volume). In the simulation "
        f"buoyancy never tips a robot over; on the bench it may float at another angle.</p>"
    )


def _prediction(bench: Bench) -> str:
    if bench.predicted is None:
        return "<p>No ensemble is available for this design, so the uncertainty of the prediction is unknown.</p>"
    each = ", ".join(f"{value:+.1f}" for value in bench.predicted)
    mean, deviation = float(np.mean(bench.predicted)), float(np.std(bench.predicted))
    to_cm = 100 * bench.scales.length
    return (
        f"<p>The study's {len(bench.predicted)} networks predict {mean:+.2f} ± {deviation:.2f} m for this design "
        f"({each}), which is {to_cm * mean:+.0f} ± {to_cm * deviation:.0f} cm on the bench. σ is the disagreement of "
        f"the networks, a lower bound on the uncertainty.</p>"
    )


def _last_steps(bench: Bench, folder: str) -> str:
    """Return the steps after assembly that the kit has servos and a timeline for."""
    steps = []
    if bench.calibration is not None:
        steps.append('Measure each servo\'s pulses and correct <a href="calibration.yaml">calibration.yaml</a>.')
    if bench.timeline is not None:
        command = f"puddle drive {escape(folder)}"
        steps.append(f"Run <code>{command} --dry-run</code>, then <code>{command} --port /dev/ttyACM0</code>.")
    return "".join(f"<li>{step}</li>\n" for step in steps)


def _timeline(bench: Bench, figure: Drawing | Missing) -> str:
    html = _figure(figure)
    if bench.calibration is not None:
        rows = []
        for servo in bench.calibration.servos:
            reach = degrees(min(servo.max_us - servo.centre_us, servo.centre_us - servo.min_us) / servo.us_per_rad)
            row = [f"joint {servo.joint}", str(servo.channel), f"{servo.centre_us:g}", f"{servo.direction:+d}"]
            rows.append([*row, f"{servo.us_per_rad:g}", f"{servo.min_us:g} to {servo.max_us:g}", f"±{reach:.0f}°"])
        head = ["servo of", "channel", "centre [µs]", "direction", "µs/rad", "limits [µs]", "reach"]
        html += _table(head, rows) + (
            "<p>These values are from the data sheet. Measure yours and correct "
            "<a href='calibration.yaml'>calibration.yaml</a>.</p>"
        )
    if bench.timeline is not None:
        html += (
            "<p>Angles and pulses at 50 Hz: <a href='timeline.json'>timeline.json</a>, "
            "<a href='timeline.csv'>timeline.csv</a>.</p>"
        )
    return html
