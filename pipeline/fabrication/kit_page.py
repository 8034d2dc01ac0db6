"""index.html of a kit: what it is, what speaks against it, what to download, and the physics of its scale."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from math import degrees
from string import Template

from pipeline.fabrication.bench import Bench
from pipeline.report.drawing import Drawing, Missing
from pipeline.report.moving import document
from pipeline.report.page import inline_svg
from pipeline.report.wording import absent
from tasks.fabrication.checks import KitFinding
from tasks.fabrication.kit import Kit
from tasks.fabrication.servos import MEASURES, Servo
from tasks.world import Physics

_POLICY = "img-src 'self' data: file:"
"""The kit's pictures lie beside its page."""

LAWS = {
    "froude": "Froude's law: gravity, buoyancy, drag and inertia keep their proportions, so the simulated motion is a "
    "prediction of the bench's. Times shrink by the root of the scale. It asks the servos to be quick.",
    "kept_frequencies": "Kept frequencies: a second stays a second. Gravity and buoyancy keep their size beside one "
    "another; inertia and drag are weaker by the scale. The robot moves slowly, within more "
    "servos' reach, but not as simulated: what is said below of its way and its speed is no prediction.",
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
    """Write the page.

    Args:
        kit: the parts.
        bench: how they will do.
        findings: of both, faults first.
        drawings: of :mod:`pipeline.fabrication.kit_figures`.
        name: of the design.
        title: of the page.
        origin: where the design comes from, in words.
        folder: what the kit is called on a command line.
        law: of scaling.
        physics: of the simulation.
        slush_density: of the simulated slush [kg/m²].
        frequency: of the design's gait [Hz of simulation].
        settings_yaml: what was chosen.
    """
    faults = [finding for finding in findings if finding.severity == "fault"]
    verdict = (
        f'<div class="notice"><b>Not to be built as it is.</b> {len(faults)} '
        f"{'fault' if len(faults) == 1 else 'faults'}: see what was found.</div>"
        if faults
        else '<p class="finding">Nothing found speaks against building it.</p>'
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
        "last": _last(bench, folder),
        "chosen": f"<details><summary>Settings</summary><pre><code>{escape(settings_yaml)}</code></pre></details>",
    }
    body, css = (files("pipeline.fabrication").joinpath(f"kit.{kind}").read_text("utf-8") for kind in ("html", "css"))
    return document(title=pieces["title"], policy=_POLICY, body=Template(body).substitute(pieces), css=f"\n{css}")


def _table(head: Sequence[str], rows: Iterable[Sequence[str]], kind: str = "") -> str:
    """Lay out cells that are HTML already; on a narrow screen a row becomes a list, each cell named by its column."""
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
        return "<p>Nothing.</p>"
    items = "".join(
        f'<li class="{found.severity}"><b>{found.severity}</b> · {escape(found.where)}: {escape(found.message)}</li>'
        for found in findings
    )
    return f'<ul class="found">{items}</ul>'


def _parts(kit: Kit) -> str:
    rows = []
    for part in kit.parts:
        links = [f'<a href="print/{part.name}.{form}">{form.upper()}</a>' for form in ("stl", "3mf")]
        links += [f'<a href="cad/{part.name}.step">STEP</a>']
        left, bottom, right, top = part.outline.bounds
        rows.append(
            [escape(part.name), f"{right - left:.0f} × {top - bottom:.0f}", f"{part.mass_g:.0f}", " ".join(links)]
        )
    profiles = " ".join(
        f'<a href="profiles/part-{body + 1}-{side}.dxf">part-{body + 1}-{side}</a>' for body, side in kit.features
    )
    return _table(["part", "size [mm]", "mass [g]", "files"], rows) + f"<p>Profiles (DXF): {profiles}</p>"


def _measures(kit: Kit, servo: Servo) -> str:
    if not kit.gauges:
        return "<p>No joint is driven: there is no servo to measure.</p>"
    (horn,) = servo.horns
    rows = [
        [
            f"<code>{name}</code>",
            words,
            f"{getattr(horn if hasattr(horn, name) else servo, name):g}",
            escape(servo.sources.get(name, "nobody: a common measure")),
        ]
        for name, words in MEASURES.items()
    ]
    prints = ", ".join(
        f'{gauge.name} ({gauge.mass_g:.0f} g: <a href="print/{gauge.name}.stl">STL</a> '
        f'<a href="print/{gauge.name}.3mf">3MF</a>)'
        for gauge in kit.gauges
    )
    taken = _table(["name", "what", "mm", "from"], rows, "left")
    return (
        f"<p>Clones of a {escape(servo.name)} differ, and horns more so. Before the parts, print the two gauges, "
        f"slices of this kit's own parts: {prints}. The servo goes into the first from above, ears on the plate, and "
        f"its screws meet their holes; the horn lies in the second with its face on the floor. With both on the servo, "
        f"the gap between them must be {kit.settings.layer_gap_mm:g} mm. Where they don't fit, say what your caliper "
        f"says, and make the kit again: <code>--set kit.measured.length_mm=40.1</code>.</p>"
        f"<details><summary>What was taken, and from whom</summary>{taken}</details>"
    )


def _bill(kit: Kit) -> str:
    rows = [
        [
            escape(line.item),
            str(line.count),
            "" if line.length_mm is None else f"{line.length_mm:.1f}",
            "" if line.mass_g is None else f"{line.mass_g:.0f}",
            escape(line.note),
        ]
        for line in kit.bill
    ]
    rows.append(["<b>all of it</b>", "", "", f"<b>{kit.mass_g:.0f}</b>", "prints, servos and steel"])
    return _table(["what", "count", "each [mm]", "all [g]", ""], rows, "noted")


def _scale(
    bench: Bench, figure: Drawing | Missing, law: str, physics: Physics, slush_density: float, frequency: float
) -> str:
    scales, servo, floating = bench.scales, bench.servo, bench.floating
    limit = physics.max_motor_torque * scales.torque
    stall = servo.stall_torque_nm * bench.servos_per_joint
    units = [
        ["length", "1 m", f"{1000 * scales.length:.0f} mm"],
        ["time", "1 s", f"{scales.time:.3f} s"],
        ["the robot's mass", f"{floating.mass_kg / scales.mass:.1f} kg", f"{1000 * floating.mass_kg:.0f} g"],
        ["torque", f"{physics.max_motor_torque:g} N·m, its motors' limit", f"{limit:.3f} N·m"],
        ["fastest gait", "0.3 Hz", f"{0.3 * scales.frequency:.2f} Hz"],
        ["this gait", f"{frequency:.3f} Hz", f"{frequency * scales.frequency:.2f} Hz"],
    ]
    if bench.simulated is not None:
        metres = bench.simulated.com_displacement
        units.append(
            [
                f"its way in {escape(bench.simulated.world)} in {bench.simulated.duration:.0f} s, centre of mass",
                f"{metres:+.2f} m",
                f"{100 * metres * scales.length:+.0f} cm in {bench.simulated.duration * scales.time:.0f} s",
            ]
        )
    loads = [
        [
            f"joint {load.joint}",
            f"{load.peak_torque:.3f}",
            f"{load.rms_torque:.3f}",
            f"{load.peak_speed:.2f}",
            f"{load.margin:.2f}×",
            f"{load.saturated:.0%}",
        ]
        for load in bench.loads
    ]
    ratio, weaker = max(stall, limit) / max(min(stall, limit), 1e-12), "stronger" if stall > limit else "weaker"
    unlike = ": where the simulated robot was too weak, on dry land say, this one may not be" if stall > limit else ""
    said = [
        f"<p>{escape(LAWS[law])}</p>",
        "<p>The paper gives the scale of lengths and not that of times; it compares whether the robot crosses the "
        "tank, not how fast. The virtual tank of a study reckons by Froude's law, whichever is chosen here. The other "
        "law is one setting away: <code>--set scaling.law=…</code>.</p>",
        _table(["", "in simulation", "on the bench"], units, "left"),
        f"<p>A {escape(servo.name)} has {servo.stall_torque_nm:.2f} N·m at rest and "
        f"{servo.no_load_speed_rad_s:.1f} rad/s unloaded, at {servo.voltage_v:g} V; {bench.servos_per_joint} at each "
        f"joint. That is {ratio:.1f} times {weaker} than the simulated "
        f"motor's limit at this scale{unlike}.</p>",
        _table(
            [
                "each servo of",
                "most torque [N·m]",
                "rms [N·m]",
                "most speed [rad/s]",
                "least margin",
                "simulated motor at its limit",
            ],
            loads,
        )
        if loads
        else "",
        _figure(figure),
        _floating(bench, physics, slush_density),
        _members(bench),
    ]
    return "".join(said)


def _floating(bench: Bench, physics: Physics, slush_density: float) -> str:
    floating = bench.floating
    if floating.draught_mm is None:
        lies = f"It sinks: it weighs {floating.sealed_share:.2f} times what it displaces at most."
    else:
        lies = (
            f"It floats with {floating.sealed_share:.0%} of its volume under, {floating.draught_mm:.0f} mm deep of "
            f"{floating.height_mm:.0f} mm, in its rest pose as drawn."
        )
    simulated = physics.link_density / slush_density if slush_density > 0 else float("inf")
    flooded = (
        f"with its pockets full it {'sinks' if floating.flooded_share > 1 else 'still floats'} "
        f"({floating.flooded_share:.0%} of what is left)"
    )
    return (
        f"<p>{1000 * floating.mass_kg:.0f} g against {1e6 * floating.sealed_m3:.0f} cm³. {lies} The simulated robot "
        f"has {simulated:.0%} under; where the two differ, weights or foam bring them together. By itself, {flooded}. "
        f"In the simulation buoyancy never tips a robot over; on the bench it may lie at another angle.</p>"
    )


def _members(bench: Bench) -> str:
    if bench.members is None:
        return "<p>No ensemble is at hand for this design, so what its members disagree by is not known.</p>"
    found, scales = bench.members, bench.scales
    each = ", ".join(f"{value:+.1f}" for value in found.displacement)
    mean_cm, deviation_cm = 100 * found.mean * scales.length, 100 * found.deviation * scales.length
    return (
        f"<p>The study's {len(found.displacement)} networks promise {found.mean:+.2f} ± {found.deviation:.2f} m for "
        f"this design ({each}), that is {mean_cm:+.0f} ± {deviation_cm:.0f} cm on the bench: σ is what they disagree "
        f"by, and the least doubt to have.</p>"
    )


def _last(bench: Bench, folder: str) -> str:
    """Say what is left once it is assembled: nothing where no joint is driven, no drive without a timeline."""
    steps = []
    if bench.calibration is not None:
        steps.append('Find each servo\'s pulses and correct <a href="calibration.yaml">calibration.yaml</a>.')
    if bench.timeline is not None:
        servo_joint = f"puddle drive {escape(folder)}"
        steps.append(f"<code>{servo_joint} --dry-run</code>, then <code>{servo_joint} --port /dev/ttyACM0</code>.")
    return "".join(f"<li>{step}</li>\n" for step in steps)


def _timeline(bench: Bench, figure: Drawing | Missing) -> str:
    said = [_figure(figure)]
    if bench.calibration is not None:
        rows = [
            [
                f"joint {s.joint}",
                str(s.channel),
                f"{s.centre_us:g}",
                f"{s.direction:+d}",
                f"{s.us_per_rad:g}",
                f"{s.min_us:g} to {s.max_us:g}",
                f"±{degrees(min(s.max_us - s.centre_us, s.centre_us - s.min_us) / s.us_per_rad):.0f}°",
            ]
            for s in bench.calibration.servos
        ]
        said.append(_table(["servo of", "channel", "centre [µs]", "direction", "µs/rad", "limits [µs]", "reach"], rows))
        said.append(
            "<p>From the data sheet, to be measured on yours: <a href='calibration.yaml'>calibration.yaml</a>.</p>"
        )
    if bench.timeline is not None:
        said.append(
            "<p>At 50 Hz, angles and pulses: <a href='timeline.json'>timeline.json</a>, "
            "<a href='timeline.csv'>timeline.csv</a>.</p>"
        )
    return "".join(said)
