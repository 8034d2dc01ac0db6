"""The moving parts of the page: the gallery, the viewer with its controls, and the script that plays both."""

import json
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from itertools import groupby
from string import Template

from pipeline.report.replay import Replay, encode
from pipeline.report.wording import absent, number
from tasks.world import ENVIRONMENTS

_EXEMPLARS = ("residual_slush", "dry_land")  # arms of the gallery: with residuals and without. Paper, Fig. 1

_SCRIPTS = ("robot.js", "viewer.js", "gallery.js")


def resource(name: str) -> str:
    """Read a file of this package."""
    return files("pipeline.report").joinpath(name).read_text(encoding="utf-8")


def document(*, title: str, policy: str, body: str, css: str = "") -> str:
    """Return a whole page, for a study or for a kit.

    Args:
        title: escaped for HTML.
        policy: Content-Security-Policy for everything but styles.
        body: HTML.
        css: styles in addition to page.css.
    """
    styles = f"{resource('page.css').rstrip()}\n{environment_css()}{css}"
    texts = {"title": title, "policy": policy, "css": styles, "body": body.rstrip()}
    return Template(resource("document.html")).substitute(texts)


def environment_css() -> str:
    """Return the colours of all environments, for a light and for a dark page."""
    light = dark = swatches = ""
    for name, kind in ENVIRONMENTS.items():
        variable = f"--{name.replace('_', '-')}"
        light += f" {variable}: {kind.color}; {variable}-adapted: {kind.adapted_color};"
        dark += f" {variable}: {kind.dark_color}; {variable}-adapted: {kind.dark_adapted_color};"
        swatches += f".{name} {{ background: var({variable}); }}\n"
    return f":root {{{light} }}\n@media (prefers-color-scheme: dark) {{ :root {{{dark} }} }}\n{swatches}"


def gallery(replays: Sequence[Replay], *, reason: str | None = None) -> str:
    """Show for each depth the best robot evolved with residuals above the best one evolved without, or the reason."""
    shown = sorted(
        (replay.depth, _EXEMPLARS.index(environment), index)
        for index, replay in enumerate(replays)
        for environment in _EXEMPLARS
        if replay.environment == environment and replay.in_true_slush
    )
    if not shown:
        none_yet = "no champion from Residual Slush or Dry Land has been filmed in True Slush yet"
        return absent("The gallery", reason or none_yet)
    cards = []
    for depth, group in groupby(shown, key=lambda entry: entry[0]):
        films = "".join(_film(replays[index], index) for _, _, index in group)
        cards.append(f'<figure class="exemplars"><h3>{depth:g} m of slush</h3>{films}</figure>')
    return f'<div id="gallery" class="gallery">{"".join(cards)}</div>'


def _film(replay: Replay, index: int) -> str:
    kind = "with residuals" if replay.environment == "residual_slush" else "without residuals"
    label = f"{kind}: {number(float(replay.frames[-1, 0, 0] - replay.frames[0, 0, 0]))} m"
    swatch = f'<span class="swatch {escape(replay.environment)}"></span>'
    return (
        f'<button type="button" class="film" data-replay="{index}" title="Open in the viewer">'
        f'<canvas role="img" aria-label="{escape(label)}"></canvas><span>{swatch}{escape(label)}</span></button>'
    )


def viewer(replays: Sequence[Replay], *, reason: str | None = None) -> str:
    """Lay out the canvas and the controls of the viewer, or give the reason why no champion can be filmed."""
    if not replays:
        return absent("The replay viewer", reason or "no champion has been filmed yet")
    numbered = sorted(enumerate(replays), key=lambda item: item[1].depth)
    # The viewer opens with the subject of the study: a robot evolved with residuals, at the greatest depth.
    chosen, _ = max(
        numbered, key=lambda item: (item[1].environment == "residual_slush", item[1].in_true_slush, item[1].depth)
    )
    overlays = dict.fromkeys(overlay.label for replay in replays for overlay in replay.overlays)
    colors = "".join(f'<option value="{escape(label)}">{escape(label)}</option>' for label in overlays)
    pushes = any(replay.push is not None for replay in replays)
    return f"""<div class="viewer" id="viewer">
<div class="bar"><label class="grow">Robot <select id="choice">{_options(numbered, chosen)}</select></label>
<label class="grow">Compare with <select id="beside"><option value="">nothing</option>
<option value="twin" selected>the same robot in its other environment</option>
{_options(numbered, None)}</select></label></div>
<canvas id="stage" role="img" aria-label="A moving robot"></canvas>
<div class="bar below"><button id="play" type="button">Play</button>
<input id="scrub" type="range" min="0" max="1" step="0.01" value="0" aria-label="Time">
<output id="time" for="scrub"></output></div>
<div id="line" hidden><canvas id="timeline" role="img" aria-label="The value of the colour over time"></canvas>
<p id="legend" class="small"></p></div>
<div class="bar below"><label>Speed <select id="speed"><option value="0.25">¼ ×</option><option value="0.5">½ ×</option>
<option value="1" selected>1 ×</option><option value="2">2 ×</option><option value="4">4 ×</option></select></label>
<label>Colour <select id="overlay"><option value="" selected>where it evolved</option>{colors}</select></label>
<label><input id="push" type="checkbox"{"" if pushes else " disabled"}> Push of the slush</label>
<label><input id="follow" type="checkbox" checked> Follow the robot</label></div>
</div>
<p class="small">The root link is darker and has a black dot; white dots are joints. The number at the top right is the
displacement of the root since the start of the measurement, after the robot has
settled.{_twin_words(replays)}{_overlay_words(overlays)}</p>"""


def _twin_words(replays: Sequence[Replay]) -> str:
    if all(replay.in_true_slush for replay in replays):
        return ""
    words = " Next to a robot in True Slush the viewer shows the same robot in the environment where it evolved."
    if any(replay.hallucinated for replay in replays):
        words += (
            " For an ensemble, that is the environment of the member whose prediction is the median (the lower of "
            "two). Hallucinated slush has a dashed surface, and its push is the member’s prediction."
        )
    return words


def _overlay_words(overlays: Iterable[str]) -> str:
    if not list(overlays):
        return (
            " Colours for the disagreement of the networks are missing, because the study has not been analysed or has "
            "no networks."
        )
    return (
        " Colour can also show where the networks are unreliable: the disagreement of the members about each link, or "
        "the distance of its state from all throws (1 is typical for a new throw). The line below the clock is the "
        "mean over the links; click on it to jump to that time."
    )


def _options(numbered: Sequence[tuple[int, Replay]], chosen: int | None) -> str:
    groups = []
    for depth, group in groupby(numbered, key=lambda item: item[1].depth):
        options = "".join(
            f'<option value="{index}"{" selected" if index == chosen else ""}>{escape(_choice(replay))}</option>'
            for index, replay in group
        )
        groups.append(f'<optgroup label="Depth {depth:g} m">{options}</optgroup>')
    return "".join(groups)


def _choice(replay: Replay) -> str:
    return replay.title if replay.in_true_slush else f"{replay.title}: in {replay.seen_in}"


def script(replays: Sequence[Replay]) -> str:
    """Return the script element with the replays and the code that plays them."""
    if not replays:
        return ""
    # "<" is written as an escape, so that no title can close the element.
    data = json.dumps([encode(replay) for replay in replays], separators=(",", ":")).replace("<", "\\u003c")
    code = "\n".join(resource(name) for name in _SCRIPTS)
    return f'<script type="application/json" id="replays">{data}</script>\n<script>\n{code}</script>'
