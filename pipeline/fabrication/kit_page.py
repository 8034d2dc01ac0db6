"""index.html of a kit: the robot, the findings, the files to download, and the physics of the scale."""

from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from math import degrees

import yaml
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from pipeline.fabrication.bench import Bench
from pipeline.fabrication.source import DesignSource
from pipeline.report.drawing import Drawing, Missing
from pipeline.report.moving import document
from pipeline.report.page import inline_svg
from pipeline.report.wording import absent
from tasks.fabrication.checks import KitFinding
from tasks.fabrication.kit import Kit
from tasks.fabrication.kit_settings import FabricationSettings
from tasks.fabrication.servos import MEASURES
from tasks.world import Physics

_POLICY = "img-src 'self' data: file:"  # the kit's pictures lie beside its page
TEMPLATES = Environment(loader=PackageLoader("pipeline.fabrication", ""), autoescape=True, undefined=StrictUndefined)


def render_kit(
    kit: Kit,
    bench: Bench,
    source: DesignSource,
    choices: FabricationSettings,
    *,
    findings: Sequence[KitFinding],
    drawings: Mapping[str, Drawing | Missing],
    physics: Physics,
    folder: str,
) -> str:
    """Render the page.

    Args:
        kit: The kit.
        bench: Loads, floating and timeline.
        source: Design and its origin.
        choices: Settings of the kit.
        findings: Findings of the kit and the bench, faults first.
        drawings: Figures of :mod:`pipeline.fabrication.kit_figures`: torque and timeline.
        physics: Physics of the simulation.
        folder: Name of the kit on a command line.

    Returns:
        The HTML document.
    """
    title = f"A robot to build: {source.name}"
    slush_density = source.settings.slush.density
    body = TEMPLATES.get_template("kit.html").render(
        kit=kit,
        bench=bench,
        source=source,
        servo=bench.servo,
        scaling=choices.scaling,
        findings=findings,
        n_faults=sum(finding.severity == "fault" for finding in findings),
        figures={name: Markup(_figure(drawing)) for name, drawing in drawings.items()},
        measures=MEASURES,
        physics=physics,
        frequency=float(source.design.frequency[0]),
        simulated_share=physics.link_density / slush_density if slush_density > 0 else float("inf"),
        settings_yaml=yaml.safe_dump(choices.model_dump(mode="json"), sort_keys=False),
        title=title,
        folder=folder,
        degrees=degrees,
    )
    css = files("pipeline.fabrication").joinpath("kit.css").read_text("utf-8")
    return document(title=escape(title), policy=_POLICY, body=body, css=f"\n{css}")


def _figure(drawing: Drawing | Missing) -> str:
    if isinstance(drawing, Missing):
        return absent(drawing.title, drawing.reason)
    caption = f"<figcaption>{escape(drawing.description)}</figcaption>"
    return f'<figure id="{drawing.name}"><h3>{escape(drawing.title)}</h3>{inline_svg(drawing)}{caption}</figure>'
